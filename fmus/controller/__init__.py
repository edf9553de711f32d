"""The FMU Controller."""

__all__: list[str] = []
