"""What the coupling of a scenario's FMUs costs."""

__all__: list[str] = []
