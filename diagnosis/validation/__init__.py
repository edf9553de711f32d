"""Simulations over whole records: their errors, parameters refitted to them, and the validation of
a model or a plant FMU.
"""

__all__: list[str] = []
