"""The FMU AdaptiveObserver."""

__all__: list[str] = []
