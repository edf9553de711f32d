"""One run of a scenario, from its file to its result folder."""

__all__: list[str] = []
