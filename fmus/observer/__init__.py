"""The FMU AdaptiveObserver."""
