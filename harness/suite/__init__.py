"""Many scenarios as tests, and their summary."""

__all__: list[str] = []
