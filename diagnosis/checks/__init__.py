"""What the records excite, and whether model and data speak of the same thing."""

__all__: list[str] = []
