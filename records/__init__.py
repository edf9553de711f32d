"""Measured records: read, brought to SI and one clock, checked."""
