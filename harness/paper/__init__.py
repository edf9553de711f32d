"""The paper's figures and numbers beside those of runs."""

__all__: list[str] = []
