"""The numbers of a run: errors of the estimates, behaviour of the plant, tracking, validation."""

__all__: list[str] = []
