"""What is said of the rest positions of an axis."""

from __future__ import annotations

from bristle.diagnosis.slow.stick_slip import Behaviour, StickSlip

OFFSET_DIGITS = 9  # of an offset: less is rounding

HEADLINES: dict[Behaviour, str] = {
    "follows": "The axis follows its input: no friction shows",
    "dead band": "The axis has a dead band: a play, or friction alike at rest and in motion",
    "stick and slip": "The axis sticks and slips",
}


def described(found: StickSlip, input_: str, output: str) -> list[str]:
    """Return lines that say what an axis does, in the units of the columns of those names."""
    offset = round(found.offset, OFFSET_DIGITS) + 0.0
    lines = [
        HEADLINES[found.behaviour],
        f"{found.samples} samples, {found.moves} moves; '{output}' = {found.gain:.4g} '{input_}'"
        f" {offset:+.4g}, the gain {_between(found.gain_interval)}",
    ]
    if found.behaviour == "follows":
        lines.append(
            f"friction, as a distance of '{input_}': less than {found.static_interval[1]:.3g}, as"
            " smaller moves are not told from noise"
        )
    if found.behaviour == "dead band":
        lines.append(
            f"dead band, either way: {found.kinetic:.4g} of '{input_}'"
            f" ({_between(found.kinetic_interval)}), {2 * found.kinetic:.4g} in all"
        )
    if found.behaviour == "stick and slip":
        beyond = "short of" if found.kinetic >= 0 else "beyond"
        lines += [
            f"it moves once '{input_}' is {found.static:.4g} ({_between(found.static_interval)})"
            " from where it stands",
            f"and stops {abs(found.kinetic):.4g} {beyond} it ({_between(found.kinetic_interval)}):"
            f" a jump of {found.jump:.4g} of '{output}'",
        ]
    errors = ", ".join(f"{name} {error:.3g}" for name, error in found.error.items())
    return [*lines, f"rms error of '{output}', predicted from the sample before: {errors}"]


def _between(interval: tuple[float, float]) -> str:
    low, high = (f"{end:.4g}" for end in interval)
    return low if low == high else f"{low} to {high}"
