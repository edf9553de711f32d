"""Many runs of one scenario with values that vary, and their store."""

__all__: list[str] = []
