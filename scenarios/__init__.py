"""The shipped scenario files."""

__all__: list[str] = []
