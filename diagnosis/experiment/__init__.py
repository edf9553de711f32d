"""What to measure next: an input that tells apart what the records do not, within their own
limits.
"""

__all__: list[str] = []
