"""A proposal as a commented model file, and as lines for the reader."""

from __future__ import annotations

import os
import shlex
import tomllib
from pathlib import Path

from bristle.common.errors import BristleError
from bristle.common.output import output_folder, replace_file
from bristle.common.toml import quoted
from bristle.common.units import parse_unit
from bristle.diagnosis.answer import Proposal
from bristle.diagnosis.modelfile import Model, own_unit
from bristle.diagnosis.report.text.said import said
from bristle.model.variables import Parameter
from bristle.plant.controller import CONTROLLER
from bristle.plant.friction import law
from bristle.plant.servo import A2, B, J
from bristle.records.choice import Candidate
from bristle.records.layout import INPUT_UNITS, SETPOINT, Column

# of the controller's parameters that are proposed, what they are
CONTROLLER_WORDS = {
    p.name.rpartition(".")[2]: p.description.format(torque="torque")
    for p in CONTROLLER.parameters
    if p.name.rpartition(".")[2] in ("kp", "ki", "kd")
}
WIDTH = 26  # letters before a comment


def _declared() -> dict[str, Parameter]:
    """Return the parameters of the proposed model."""
    return {"J": J, "a2": A2, **{p.name.rpartition(".")[2]: p for p in law("coulomb").parameters}}


def resolution_of(proposal: Proposal) -> tuple[float, str] | None:
    """Return the step that the output shows, in SI and as text in its unit; None if none."""
    step = max((record.resolution or 0.0 for record in proposal.records), default=0.0)
    if not step:
        return None
    unit = parse_unit(proposal.output.column.unit)
    scale = proposal.output.column.scale
    number, _, over = (scale or "1 1").partition(" ")
    factor = abs(unit.factor * float(number) * parse_unit(over or "1").factor)
    return step, f"{step / factor:.6g}"


def model_text(proposal: Proposal, command: str) -> str:
    """Return the model file; `command` is what to do with it next."""
    names = ", ".join(path.name for path in proposal.paths)
    lines = [
        f"# Proposed by bristle init from {names}; check what is assumed:",
        *(f"#   - {said(line)}" for line in proposal.doubts or ("nothing",)),
        f"# Next: {command}",
        "",
        _with('friction = "coulomb"', "bristle list names other friction laws"),
        "",
        _with(
            "[parameters]",
            "rough, from a regression of the input; any effect that is missing biases it",
        ),
    ]
    lines += _parameter_lines(proposal)
    lines += ["", _with("[bounds]", "how far each may move; what is not listed stays")]
    lines += [f"{name} = [{rough.low!r}, {rough.high!r}]" for name, rough in proposal.rough.items()]
    lines += _controller_lines(proposal)
    for role in ("time", "input", "output"):
        candidate: Candidate = getattr(proposal, role)
        lines += ["", f"[{role}]", *_declaration(candidate)]
        lines += [_sensor_line(proposal)] if role == "output" else []
        for other in proposal.others[role]:
            lines += ["# or:", *(f"# {line}" for line in _declaration(other))]
    lines += _goal_lines(proposal) + _load_lines(proposal)
    return "\n".join(lines) + "\n"


def _goal_lines(proposal: Proposal) -> list[str]:
    """Return how a goal beside the input would be given, as comments, where there is one."""
    goals = [each for each in proposal.others["input"] if each.kind == SETPOINT]
    if not goals or proposal.output.kind != "position":
        return []
    return [
        "",
        "# if a controller made the input of this goal:",
        "# [input.goal]             # its gains are then seen beside the servo",
        *(f"# {line}" for line in _column_lines(goals[0].column)),
    ]


def _load_lines(proposal: Proposal) -> list[str]:
    """Return how a second position would be given, as comments, where there is another one."""
    positions = [each for each in proposal.others["output"] if each.kind == "position"]
    if not positions or proposal.output.kind != "position":
        return []
    return [
        "",
        "# if both are positions of one axis, the motor's above and the load's here:",
        "# [output.load]            # play and compliance between them are then seen directly",
        *(f"# {line}" for line in _column_lines(positions[0].column)),
    ]


def _parameter_lines(proposal: Proposal) -> list[str]:
    """Return a line for each rough parameter, with its unit and what is known of it."""
    linear, kind = proposal.output.linear, _drive(proposal)
    gain, declared, lines = kind in ("voltage", "current"), _declared(), []
    for name, rough in proposal.rough.items():
        about = (
            f"+- {rough.error:.2g}"
            if rough.error is not None
            else "a guess"
            if name == "J"
            else "not shown by these records"
        )
        per = f" for b = 1 {own_unit(B, linear, kind)}" if gain else ""
        lines.append(
            _with(
                f"{name} = {rough.value!r}",
                f"{own_unit(declared[name], linear, kind)}{per}, {about}:"
                f" {declared[name].description}",
            )
        )
    if gain:
        unit = own_unit(B, linear, kind)
        about = (
            f"{unit}: not shown by input and output; if you know it, multiply J, a2, Fc and their"
            " bounds by it"
        )
        lines.append(_with("b = 1.0", about))
    return lines


def _drive(proposal: Proposal) -> str:
    """Return what drives the axis, for the units of its parameters."""
    if proposal.input.kind != SETPOINT:
        return proposal.input.kind
    return "force" if proposal.output.linear else "torque"


def _controller_lines(proposal: Proposal) -> list[str]:
    """Return the table of the controller, with what the records show of it as comments."""
    if proposal.controller is None:
        return []
    about = "what you know of it; a kp makes all torques absolute"
    shown = [
        _with(f"# {name} = {proposal.controller[name]:.3g}", CONTROLLER_WORDS[name])
        for name in CONTROLLER_WORDS
        if proposal.controller.get(name)
    ]
    return ["", _with("[controller]", about), *shown]


def _sensor_line(proposal: Proposal) -> str:
    """Return what is declared of the output's steps."""
    if proposal.differences:
        return _with("differences = true", "of the readings of a position: it is summed to that")
    shown = resolution_of(proposal)
    return f"resolution = {shown[1]}" if shown else "# resolution: the output shows no steps"


def next_command(proposal: Proposal, out: Path) -> str:
    """Return the command that diagnoses the records with the model file."""
    return shlex.join(["bristle", "diagnose", str(out), "--data", *map(str, proposal.paths)])


def write_model(proposal: Proposal, out: Path, replace_it: bool = False) -> None:
    """Write the model file, whole or not at all; `BristleError` if it must not be replaced."""
    if out.suffix.lower() != ".toml":
        raise BristleError(f"{out}: is no name of a model file; write for example model.toml")
    if out.is_dir() or (os.path.lexists(out) and not replace_it):
        raise BristleError(f"{out}: exists already; give another name, or allow it to be replaced")
    text = model_text(proposal, next_command(proposal, out))
    Model.from_dict(tomllib.loads(text), out)
    with output_folder(out.parent):
        replace_file(out, text.encode())


def _with(line: str, comment: str) -> str:
    return f"{line:<{WIDTH - 1}} # {comment}"


def _declaration(candidate: Candidate) -> list[str]:
    if candidate.rate:
        return [f'rate = "{candidate.rate!r} Hz"']
    lines = _column_lines(candidate.column)
    others = (
        "torque, force, voltage, current or setpoint"
        if candidate.kind in (*INPUT_UNITS, SETPOINT)
        else "position or velocity"
    )
    return (
        lines
        if candidate.kind == "time"
        else [*lines, _with(f"kind = {quoted(candidate.kind)}", others)]
    )


def _column_lines(column: Column) -> list[str]:
    lines = [f"column = {quoted(column.column)}", f"unit = {quoted(column.unit)}"]
    if column.scale is None:
        return lines
    return [*lines, _with(f"scale = {quoted(column.scale)}", "what one of the unit is worth")]


def summary(proposal: Proposal) -> list[str]:
    """Return what was chosen, what the records excite and what is not certain, for a terminal."""
    x, first = proposal.excited.numbers, proposal.records[0]
    linear = proposal.output.linear
    shown = resolution_of(proposal)
    steps = f", in steps of {shown[1]}" if shown else ", without steps"
    steps = (
        ", as differences of a position's readings: it is summed to that"
        if proposal.differences
        else steps
    )
    # the columns as they were read
    lines = [
        f"time    {_of(proposal.time)}, every {1e3 * first.h:.4g} ms{_or(proposal, 'time')}",
        f"input   {_of(proposal.input)}, {proposal.input.kind}{_or(proposal, 'input')}",
        f"output  {_of(proposal.output)}, {proposal.output.kind}{steps}{_or(proposal, 'output')}",
    ]
    # rough parameters, and what the records excite
    lines.append(_rough_line(proposal))
    length = "m" if linear else "rad"
    speed, band = x["speed_range"], x["input_bandwidth"]["value"]
    lines.append(
        f"excited {x['duration']['value']:.3g} s; speed {speed['lowest']:.3g} to"
        f" {speed['highest']:.3g} {length}/s, range {x['range_travelled']['value']:.3g} {length},"
        f" {x['reversals']} reversals, at rest {x['rest_share']:.0%}, input up to {band:.2g} Hz"
    )
    if proposal.loop is not None:
        lines.append(
            "loop    the input answers the position: a position loop of about"
            f" {proposal.loop:.2g} Hz"
        )
    # what is not certain
    notes = [*proposal.doubts, *(line for record in proposal.records for line in record.findings)]
    if proposal.excited.uniform:
        why = said(proposal.excited.uniform)
        notes.append(f"these records cannot tell effects apart by form: {why}")
    return [*lines, *(f"  - {said(line)}" for line in (*notes, *proposal.excited.caveats))]


def _rough_line(proposal: Proposal) -> str:
    """Return the rough parameters, and what they explain."""
    linear = proposal.output.linear
    units = _declared()
    values = ", ".join(
        f"{n} {r.value:g} {own_unit(units[n], linear, _drive(proposal))}"
        for n, r in proposal.rough.items()
    )
    per = (
        ""
        if _drive(proposal) in ("torque", "force")
        else f", for b = 1 {own_unit(B, linear, proposal.input.kind)}"
    )
    if proposal.controller is None:
        return f"rough   {values}{per}; they explain {proposal.explained:.0%} of the input"
    own = proposal.controller
    gains = [f"{k} {own[k]:.3g}" for k in CONTROLLER_WORDS if own.get(k)]
    return f"rough   {values}, of a controller with {', '.join(gains)}"


def _or(proposal: Proposal, role: str) -> str:
    """Return the other columns that may have a role."""
    names = [f"'{each.column.column}'" for each in proposal.others[role]]
    return f" (or {', '.join(names)})" if names else ""


def _of(candidate: Candidate) -> str:
    if candidate.rate:
        return f"no column, {candidate.rate:.6g} Hz"
    column = candidate.column
    return f"'{column.column}' in {column.unit}" + (f" x {column.scale}" if column.scale else "")
