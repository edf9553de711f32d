"""Whole records in open loop: how far a model is from them, and parameters refitted to them."""

__all__: list[str] = []
