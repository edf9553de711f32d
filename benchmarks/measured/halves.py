"""EMPS by halves: a diagnosis of one half of the record, its model simulated in open loop over the
other half.

python benchmarks/measured/halves.py
"""

from __future__ import annotations

import sys

import measured_data as measured
from cases import declared, taken

from bristle.diagnosis import diagnose
from bristle.diagnosis.report.export import augment
from bristle.diagnosis.workflow import validate


def main() -> int:
    """Print the errors."""
    [entry] = measured.emps()
    model = declared("voltage", {"J": 100.0, "a2": 150.0, "Fc": 30.0, "b": entry[4]["gain"]}, "m")
    [whole] = taken(model, [entry])
    middle = len(whole) // 2
    first, second = whole.part(slice(middle)), whole.part(slice(middle, None))
    for fitted, other, name in ((first, second, "second"), (second, first, "first")):
        found = diagnose(model, [fitted])
        augmented = augment(found)
        assert augmented is not None
        [row] = validate(augmented.model, [other]).records
        names = ", ".join(e.name for e in found.effects) or "nothing"
        print(
            f"{names} named; {name} half: {1e3 * row.rms:.2f} mm rms, FIT {row.fit_percent:.2f} %"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
