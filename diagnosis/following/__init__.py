"""Servos that follow a setpoint: the kind of their controller and its gains, before the search."""

__all__: list[str] = []
