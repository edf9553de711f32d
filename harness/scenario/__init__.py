"""Scenario files, what they name, and what is co-simulated for them."""

__all__: list[str] = []
