"""What to measure next: the input that tells rivals apart."""

__all__: list[str] = []
