"""The sentence on the input that was designed to tell rivals apart."""

from __future__ import annotations

from bristle.diagnosis.answer import DesignedInput
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report.text.names import NATS, effect_name, listed
from bristle.diagnosis.report.text.said import said

EXPERIMENT_FILE = "experiment.csv"  # holds the input of a record that would tell rivals apart


def designed_line(designed: DesignedInput | None, model: Model) -> str:
    """Return what to play back and what it is expected to tell, or that nothing within the limits
    would; empty for None.
    """
    if designed is None:
        return ""
    effects = [effect_name(name, model.wording) for name in designed.rivals if name]
    names = listed([*effects, *(["no further effect"] if "" in designed.rivals else [])], "and")
    if not designed.written:
        return (
            "No input was found that keeps to the range of input and position of these records and"
            f" tells apart {names}: the best one is expected to bring {designed.gain:.2g} nats, of"
            f" {designed.level:.2g} that are needed ({NATS}). Widen the range, or the input."
        )
    motion = said(designed.motion) if designed.motion else ""
    unit = "" if designed.unit == "1" else f" {designed.unit}"
    ends = f"{designed.time[-1]:.3g} s, from {designed.low:.3g} to {designed.high:.3g}{unit}"
    told = (
        f"It is expected to tell apart {names} by {designed.gain:.3g} nats or more ({NATS}). Then"
        " diagnose the new record together with these."
    )
    if designed.loop is not None:
        return (
            f"{EXPERIMENT_FILE} is a position reference for the loop as it is (here: about"
            f" {designed.loop:.2g} Hz): {motion}, {ends}. Input and position are expected to stay"
            f" within those of these records. Record input and position as before. {told}"
        )
    place = "m" if model.linear else "rad"
    begin = (
        "" if model.output_kind == "velocity" else f", from rest at {designed.start:.4g} {place}"
    )
    return (
        f"{EXPERIMENT_FILE} is such an input, to be played back in open loop{begin}: {motion},"
        f" {ends}, {designed.rms:.3g}{unit} rms, within the input and position of these records."
        f" {told}"
    )
