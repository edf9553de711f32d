"""While a servo slides, its friction is a known function: the likelihood of its records there."""

__all__: list[str] = []
