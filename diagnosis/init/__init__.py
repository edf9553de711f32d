"""A model file proposed from measured files alone."""

__all__: list[str] = []
