"""Which effects are missing: candidates, chance, criterion, stepwise search."""
