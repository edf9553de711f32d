"""Scenarios as packages for other laboratories, and runs of what comes from them."""

__all__: list[str] = []
