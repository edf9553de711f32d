"""Readers of measured files, one file a family of formats; all return `Columns`."""

__all__: list[str] = []
