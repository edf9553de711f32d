"""The accuracy of the plant FMU is a parameter of it."""

import numpy as np
import pytest

from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.cosim.drive import Drive


@pytest.mark.parametrize("law", ["modified", "lugre", "gms"])
def test_a_smaller_tolerance_leaves_a_smaller_error(law):
    """As the table of docs/fmus.md says: 1e-6 leaves some 1e-7 rad, the default far less."""
    h = 1e-3
    t = h * np.arange(4000)
    u = 1.5 * np.sin(6 * t) + 0.8 * np.sin(17 * t)
    fmu = Fmu(obtain("plant", law=law))
    drive = Drive(fmu, ["u"], ["theta"], ["solver.tolerance"])
    tolerances = [1e-12, 1e-4, 1e-6, fmu.start("solver.tolerance")]
    try:
        exact, *found = drive.run(u[:, None], np.array(tolerances)[:, None], h)[:, :, 0]
    finally:
        drive.close()
    coarse, usual, default = (float(np.max(np.abs(each - exact))) for each in found)
    assert np.ptp(exact) > 0.2
    assert 1e-10 < usual < 5e-7
    assert usual < coarse / 5
    assert default < usual / 5
