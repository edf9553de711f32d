"""The variables of the bus: what an FMU must have, and may have, to take part."""

from __future__ import annotations

# Variables of the bus and their SI units; an FMU must have the `NEEDED_PORTS`.
BUS_PORTS = {
    "plant": {
        "inputs": {"u": "V", "tau_load": "N.m", "load_scale": "1"},
        "outputs": {"theta": "rad", "v": "rad/s", "F": "N.m", "theta_enc": "rad", "v_enc": "rad/s"},
    },
    "controller": {
        "inputs": {"y_v": "rad/s", "u_ff": "V", "reference_scale": "1"},
        "outputs": {"u": "V", "reference": "rad/s", "u_compensation": "V"},
    },
    "observer": {"inputs": {"u": "V", "y_theta": "rad", "y_v": "rad/s"}, "outputs": {}},
}
# unit of a plant: others it may have
UNITS_OF_RIGS = {"V": ("A", "N.m", "N"), "rad": ("m",), "rad/s": ("m/s",), "N.m": ("N",)}
NEEDED_PORTS = {"plant": ("u", "theta", "v"), "controller": ("y_v", "u"), "observer": ("u",)}
# which a stimulus may drive
FREE_INPUTS = {"plant": ("u", "tau_load", "load_scale"), "controller": ("u_ff", "reference_scale")}
# plant outputs: position, velocity
SENSOR_OUTPUTS = {"clean": ("theta", "v"), "encoder": ("theta_enc", "v_enc")}
WHOLE_PARAMETERS = {  # Real parameters that only take whole values
    "controller": ("seed", "order"),
    "plant": ("input_noise.seed", "encoder.counts"),
}
SELECTOR_PARAMETERS = {"plant": "law", "observer": "method"}  # parameter that chooses among several
