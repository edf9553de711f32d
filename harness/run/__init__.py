"""One run of a scenario, from its file to its result folder."""
