"""Continue the observers of test_observer.py in a process of their own: continued.py FOLDER."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from bristle.fmus import obtain
from bristle.fmus.host import Fmu, Slave

H = 1e-3
SEEN = ("u", "y_theta", "y_v")
OUTPUTS = ("alpha2_hat", "b_hat", "sigma0_hat", "c_hat", "theta_hat", "v_hat", "w_hat")


def advance(slave, seen, first, last):
    """Step through rows of a record and return the outputs, a row a step."""
    rows = []
    for k in range(first, last):
        for i, name in enumerate(SEEN):
            slave.set_value(name, float(seen[k, i]))
        slave.instance.doStep(k * H, H)
        rows.append([slave.get_value(name) for name in OUTPUTS])
    return np.array(rows)


def main(folder):
    """Restore each state that was handed over, and go on with the second half of the record."""
    jobs = json.loads((folder / "jobs.json").read_text(encoding="utf-8"))
    seen, fmu, found = np.load(folder / "seen.npy"), Fmu(obtain("observer")), {}
    for method, state in jobs.items():
        with Slave(fmu, method) as slave:
            slave.initialise({})
            slave.instance.setFMUstate(slave.instance.deSerializeFMUstate(bytes.fromhex(state)))
            found[method] = advance(slave, seen, len(seen) // 2, len(seen) - 1)
    np.savez(folder / "found.npz", **found)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
