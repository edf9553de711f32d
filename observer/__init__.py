"""Adaptive observers, one a file."""
