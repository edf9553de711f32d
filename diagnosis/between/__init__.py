"""What lies between two sensors of a position: play, compliance, an eccentric or wavy drive."""

__all__: list[str] = []
