"""Scenarios, co-simulation, metrics, verdicts, reports."""
