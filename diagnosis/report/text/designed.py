"""The sentence on the input that was designed to tell rivals apart."""

from __future__ import annotations

from bristle.diagnosis.answer import DesignedInput
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report.text.names import NATS, effect_name, listed
from bristle.diagnosis.report.text.said import said

EXPERIMENT_FILE = "experiment.csv"  # holds the input of a record that would tell rivals apart


def designed_line(found: DesignedInput | None, model: Model) -> str:
    """Return what to play back and what it is expected to tell, or that nothing within the limits
    would; empty for None.
    """
    if found is None:
        return ""
    effects = [effect_name(name, model.wording) for name in found.rivals if name]
    names = listed([*effects, *(["no further effect"] if "" in found.rivals else [])], "and")
    if not found.written:
        return (
            "No input was found that keeps to the range of input and position of these records and"
            f" tells apart {names}: the best one is expected to bring {found.gain:.2g} nats, of"
            f" {found.level:.2g} that are needed ({NATS}). Widen the range, or the input."
        )
    motion = said(found.motion) if found.motion else ""
    unit = "" if found.unit == "1" else f" {found.unit}"
    place = "m" if model.linear else "rad"
    begin = "" if model.output_kind == "velocity" else f", from rest at {found.start:.4g} {place}"
    return (
        f"{EXPERIMENT_FILE} is such an input, to be played back in open loop{begin}: {motion},"
        f" {found.time[-1]:.3g} s, from {found.low:.3g} to {found.high:.3g}{unit},"
        f" {found.rms:.3g}{unit} rms, within the input and position of these records. It is"
        f" expected to tell apart {names} by {found.gain:.3g} nats or more ({NATS}). Then diagnose"
        " the new record together with these."
    )
