"""Scenarios, co-simulation, metrics, verdicts, reports."""

__all__: list[str] = []
