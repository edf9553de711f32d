"""Axes that rest between two samples, such as a valve in a historian's log."""

__all__: list[str] = []
