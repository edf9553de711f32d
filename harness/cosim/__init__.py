"""Co-simulation of FMUs over a bus, in this process or in one of its own."""

__all__: list[str] = []
