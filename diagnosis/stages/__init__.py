"""What follows the search, stage by stage: conclusion, and whole answers drawn from its fits."""

__all__: list[str] = []
