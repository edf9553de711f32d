"""The FMU ServoPlant."""

__all__: list[str] = []
