"""What the coupling of a scenario's FMUs costs."""
