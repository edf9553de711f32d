"""Where the residual is, and whether something is left unexplained."""

__all__: list[str] = []
