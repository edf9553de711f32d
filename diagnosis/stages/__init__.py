"""What follows the search, stage by stage: the conclusion, whole answers drawn from its fits, and
what to measure next.
"""

__all__: list[str] = []
