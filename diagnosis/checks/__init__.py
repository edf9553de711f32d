"""What the records excite, and whether model and data agree in columns, units and signs."""

__all__: list[str] = []
