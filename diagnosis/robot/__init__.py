"""Arms of several joints: what the rest of an arm asks of each of them."""

__all__: list[str] = []
