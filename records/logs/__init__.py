"""Logs of robots and drives: topics and channels, each family with a time of its own."""

__all__: list[str] = []
