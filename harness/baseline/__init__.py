"""References of scenarios with measured tolerances, and comparisons with them."""

__all__: list[str] = []
