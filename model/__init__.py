"""Ground floor: parameters, systems of equations, integrators, generators."""
