"""The sentences of an answer, written from its codes."""

__all__: list[str] = []
