"""The servo: drive, friction law, encoder."""

__all__: list[str] = []
