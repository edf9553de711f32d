"""Many scenarios as tests, and their summary."""
