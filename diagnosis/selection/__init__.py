"""Which effects are missing: candidates, chance, criterion, stepwise search."""

__all__: list[str] = []
