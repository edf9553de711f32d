"""A plant FMU as the model."""
