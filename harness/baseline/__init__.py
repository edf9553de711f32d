"""References of scenarios with measured tolerances, and comparisons with them."""
