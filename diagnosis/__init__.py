"""Measured records against a model: where they disagree, which effect is missing, and how far the gap shrinks."""
