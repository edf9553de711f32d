"""The variables of the bus: what an FMU must have, and may have, to take part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Ports:
    """The variables of one unit on the bus, and those of its parameters that are special.

    Attributes
    ----------
    inputs, outputs : mapping of str to str
        SI units by name.
    needed : tuple of str
        Those that its FMU must have.
    free : tuple of str
        Inputs that a stimulus may drive.
    rig_units : mapping of str to tuple of str
        Other units that its variables may have, by their SI units.
    whole : tuple of str
        Real parameters that only take whole values.
    selector : str
        Parameter that chooses among several laws or methods; empty where there is no choice.
    """

    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    needed: tuple[str, ...]
    free: tuple[str, ...] = ()
    rig_units: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    whole: tuple[str, ...] = ()
    selector: str = ""

    @property
    def units(self) -> dict[str, str]:
        """SI units of inputs and outputs by name."""
        return {**self.inputs, **self.outputs}

    def allowed_units(self, variable: str) -> list[str]:
        """Return the units that a variable may have, the SI unit first; none if it is unknown."""
        unit = self.units.get(variable)
        return [] if unit is None else [unit, *self.rig_units.get(unit, ())]


PLANT = Ports(
    inputs={"u": "V", "tau_load": "N.m", "load_scale": "1"},
    outputs={"theta": "rad", "v": "rad/s", "F": "N.m", "theta_enc": "rad", "v_enc": "rad/s"},
    needed=("u", "theta", "v"),
    free=("u", "tau_load", "load_scale"),
    rig_units={"V": ("A", "N.m", "N"), "rad": ("m",), "rad/s": ("m/s",), "N.m": ("N",)},
    whole=("input_noise.seed", "encoder.counts"),
    selector="law",
)
CONTROLLER = Ports(
    inputs={"y_v": "rad/s", "u_ff": "V", "reference_scale": "1"},
    outputs={"u": "V", "reference": "rad/s", "u_compensation": "V"},
    needed=("y_v", "u"),
    free=("u_ff", "reference_scale"),
    whole=("seed", "order"),
)
OBSERVER = Ports(
    inputs={"u": "V", "y_theta": "rad", "y_v": "rad/s"},
    outputs={},
    needed=("u",),
    selector="method",
)
PORTS = {"plant": PLANT, "controller": CONTROLLER, "observer": OBSERVER}
# plant outputs: position, velocity
SENSOR_OUTPUTS = {"clean": ("theta", "v"), "encoder": ("theta_enc", "v_enc")}
