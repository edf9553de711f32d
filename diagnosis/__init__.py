"""Measured records against a model: where they disagree, which effect is missing, and the model with it."""
