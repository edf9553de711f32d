"""Measured records against a model: where they disagree, the name of what is missing, and the model with it added."""
