"""The FMU Controller."""
