"""The figures of the pages, as SVG."""

__all__: list[str] = []
