"""The normalised parameters of a servo: the true values that a plant publishes, and what an
observer estimates.
"""

from __future__ import annotations

NORMALISED = {  # name: (unit, meaning)
    "alpha2": ("1/s", "viscous friction over inertia"),
    "b": ("rad/(s2.V)", "drive gain over inertia"),
    "Fc": ("rad/s2", "Coulomb friction over inertia"),
    "sigma0": ("1/s2", "stiffness over inertia"),
    "sigma1": ("1/s2", "weight of basis function 1"),
    "sigma2": ("1/s2", "weight of basis function 2"),
    "c": ("1/rad", "inverse presliding distance"),
    "tau": ("s", "bristle damping over stiffness"),
    "vc": ("rad/s", "speed above which friction is Coulomb and viscous"),
    "a0": ("rad", "presliding distance at high speed"),
    "a1": ("rad", "what is added to it at rest"),
    "v0": ("rad/s", "Stribeck velocity"),
    "sigma0_1": ("1/s2", "stiffness over inertia of the first of three elements side by side"),
    "sigma0_2": ("1/s2", "stiffness over inertia of the second of three elements side by side"),
    "sigma0_3": ("1/s2", "stiffness over inertia of the third of three elements side by side"),
}
OBSERVED = NORMALISED | {  # what an observer may estimate beside the servo's own parameters
    "width": ("1", "widths and centres of the basis functions over the nominal ones"),
    "load": ("rad/s2", "constant or slowly moving load torque over inertia"),
    "delay": ("1", "delay of the measurement behind the input, in samples"),
}


def units(*names: str) -> dict[str, str]:
    """Return name -> unit of some of them."""
    return {name: OBSERVED[name][0] for name in names}
