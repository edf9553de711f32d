"""A servo fitted to segments of records: simulation, noise, likelihood, optimiser, uncertainty."""

__all__: list[str] = []
