"""Ground floor: parameters, systems of equations, integrators, generators."""

__all__: list[str] = []
