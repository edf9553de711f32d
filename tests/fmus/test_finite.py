"""No variable of any FMU is ever NaN or infinite, whatever law or method is chosen; what there is
none of is 0 and not valid.
"""

import numpy as np
import pytest

# all others are real
KINDS = {"Boolean": "Boolean", "Enumeration": "Integer", "Integer": "Int32", "Int32": "Int32"}
STEPS, H = 400, 1e-3
CASES = [
    ("plant", {}),
    ("plant", {"law": "lugre"}),
    ("plant", {"law": "coulomb", "effects": ("compliance", "measurement_delay")}),
    ("observer", {}),
    ("controller", {}),
]


def signals(k):
    """Return the inputs at step k, by name: a drive that reverses, and a sensor that turns back and
    forth.
    """
    u, v = 8.0 * np.sign(np.sin(0.03 * k)), 5.0 * np.sin(0.03 * k)
    others = {"tau_load": 1e-3, "load_scale": 1.0, "u_ff": 1.0, "reference_scale": 0.5}
    return {"u": u, "y_v": v, "y_theta": 5.0 * H / 0.03 * (1.0 - np.cos(0.03 * k)), **others}


def selectors(fmu):
    """Return the values of the selector, or one None."""
    found = [
        v
        for v in fmu.description.modelVariables
        if v.type == "Enumeration" and v.causality == "parameter"
    ]
    return [(found[0].name, k) for k in range(1, int(found[0].max) + 1)] if found else [None]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    "case", CASES, ids=lambda case: "-".join([case[0], *map(str, case[1].values())])
)
def test_every_variable_is_finite_all_the_time(built, Raw, case, fmi):
    fmu = built(case[0], fmi=fmi, **case[1])
    raw = Raw(fmu.info)
    variables = [(v.name, KINDS.get(v.type, "Real")) for v in fmu.description.modelVariables]
    inputs = fmu.names("input")
    assert inputs
    for choice in selectors(fmu):
        handle = raw.instantiate()
        if choice:
            assert raw.set(handle, *choice, "Integer") == 0
        assert raw.start(handle) == 0
        for k in range(STEPS):
            if k % 50 == 0:
                values = {name: raw.read(handle, name, kind)[1] for name, kind in variables}
                assert [name for name, value in values.items() if not np.isfinite(value)] == [], (
                    choice,
                    k,
                )
            now = signals(k)
            for name in inputs:
                if name.endswith("_valid"):
                    assert raw.set(handle, name, k % 100 < 70, "Boolean") == 0
                else:  # an estimate that the controller is given
                    assert raw.set(handle, name, float(now.get(name, 3.0 * np.sin(0.1 * k)))) == 0
            assert raw.step(handle, H * k, H) == 0, raw.messages
        raw.free(handle)
