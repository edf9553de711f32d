"""A plant FMU as the model."""

__all__: list[str] = []
