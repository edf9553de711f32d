"""A sentence, or a part of one, for each reason."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from bristle.diagnosis.answer import Finding, Line, Reason

R = Reason

# Places in braces are filled with the facts of a finding; a fact that is a finding itself with its
# words, names with commas between them.
SENTENCES: dict[Reason, str] = {
    # the motion is too uniform
    R.ONE_OSCILLATION: (
        "the servo repeats one oscillation; record steps of several sizes, slow motion over several"
        " turns and a chirp"
    ),
    R.SHORT_RECORDS: "the records last {seconds:.3g} s in all; record 20 s or more",
    R.SMALL_RANGE: (
        "the servo moves less than a quarter turn, and slowly; record fast and slow motion over"
        " several turns"
    ),
    # what the records cannot show
    R.ONE_DIRECTION: (
        "nearly always in one direction: friction, bias and the mean of gravity cannot be"
        " distinguished"
    ),
    R.NO_REST: (
        "hardly ever at rest: bias and asymmetric friction cannot be distinguished; add a rest"
        " phase"
    ),
    R.MOSTLY_REST: "at rest for {share:.0%} of the time: effects that need motion hardly show",
    R.FEW_REVERSALS: "only {reversals} reversals: presliding, backlash and dead zone hardly show",
    R.NO_SLOW_MOTION: (
        "hardly ever slow: Stribeck friction and cogging hardly show; add slow motion"
    ),
    R.EVEN_SPEED: (
        "speed hardly varies: viscous friction, drag and Coulomb friction cannot be distinguished"
    ),
    R.LESS_THAN_HALF_A_TURN: (
        "less than half a turn: gravity is similar to a spring or a bias, an eccentric encoder to a"
        " gain"
    ),
    R.LESS_THAN_TWO_TURNS: (
        "less than two turns: effects that repeat every turn may be taken for others"
    ),
    R.NARROW_BAND: (
        "input bandwidth {bandwidth:.2g} Hz: a delay and an electrical pole below {alike:.2g} s are"
        " indistinguishable"
    ),
    R.NO_FAST_INPUT: "input stays below 5 Hz: compliance does not show; add a chirp",
    R.ONE_FREQUENCY: "one dominant frequency: effects of speed, position and time vary together",
    R.ONE_SIGN: "input of one sign: a gain that differs between the signs does not show",
    R.NO_LONG_TIME: "{seconds:.3g} s in all: slow drift does not show",
    R.OVERLAPPING_TIMES: (
        "times of the records overlap: a clock of its own is assumed for each, so that a step in"
        " time is searched with each record as the last one, and a drift anew in each or from one"
        " to the next; log one time for all records if you can"
    ),
    R.UNKNOWN_POSITIONS: (
        "velocities only: position 0 is assumed at the beginning of each record; effects that"
        " depend on the position are found, with the right phase, only if all records begin at the"
        " same position"
    ),
    # what looks like a mistake
    R.IN_RECORD: "record {record}: {what}",
    R.UNSIGNED_SPEED: (
        "output looks like a speed without its sign: '{column}' keeps one sign under an input of"
        " both, and as given the model explains {explained:.0%} of the torque; restore the sign, or"
        " measure the position"
    ),
    R.WRONG_INERTIA: (
        "J comes out at x{ratio:.3g} of its nominal value; check the units of input, output and"
        " time"
    ),
    # what was noticed
    R.LITTLE_MOTION: "too little motion to check signs and units",
    R.KNOWN_TORQUE_OFF: (
        "the known torque fits best times {scale:.3f} ({ci95[0]:.3f} to {ci95[1]:.3f}): the mass,"
        " the gravity or the gear of the model that it comes from is off by as much"
    ),
    R.RATIOS_TO_GAIN: (
        "no torque was measured: J, a2, friction and all other torques are relative to the"
        " controller's kp, taken as {kp:.4g} {unit}; only their ratios are known, so if you know kp"
        " or any one of them, scale all by it"
    ),
    R.SCALED_TO_GAIN: (
        "with kp = {kp:.4g} {unit} the records ask for an inertia of {inertia:.3g} {inertia_unit},"
        " outside its bounds [{bounds[0]:.3g}, {bounds[1]:.3g}]: J, a2 and friction of the model,"
        " and their bounds, were taken times {scale:.3g}; if that cannot be, kp or its unit is"
        " wrong"
    ),
    R.OUTSIDE_BOUNDS: (
        "{name} comes out near {value:.3g} {unit} without any effect, outside its bounds"
        " [{bounds[0]:.3g}, {bounds[1]:.3g}]; if that is true, widen them"
    ),
    R.INPUT_CHANGES: (
        "the input seems to change between samples: a mix of {share:.2g} of the next sample and the"
        " rest of the last one is used ({gain:.0f} nats likelier than a held input); log it as"
        " often as the drive sets it, and look for a lag in its reading"
    ),
    R.ALIASED: (
        "record {record}: from {begin:.3g} s on the input oscillates faster than a quarter of the"
        " sampling rate ({rate:.3g} Hz), so that its samples do not show it (aliasing): that part,"
        " until the input rests, is left out; log faster, or excite more slowly"
    ),
    R.ALIASED_THROUGHOUT: (
        "record {record}: the input oscillates faster than a quarter of the sampling rate"
        " ({rate:.3g} Hz), so that its samples do not show it (aliasing), and no other part is"
        " long enough; log faster, or excite more slowly"
    ),
    R.SHORTER_SEGMENTS: (
        "the simulation diverges from these records within {usual:.3g} s: segments of {seconds:.3g}"
        " s were compared instead"
    ),
    R.BEGINS_ANEW: "{effect} begins anew in each record, since each has a clock of its own",
    R.GOES_ON: "{effect} goes on from one record to the next in the order given: {records}",
    R.SETS_IN: (
        "{effect} sets in at {seconds:.4g} s by the clock of record {record}; its onset counts time"
        " over the records one after the other: {records}"
    ),
    # what a time budget left out
    R.EFFECTS_UNFINISHED: "effects not tried to the end in the last round: {effects}",
    R.BEST_STARTS_ONLY: "effects were tried from their best start values only",
    R.NO_FURTHER_EFFECT: "no further effect was looked for",
    R.NOT_REFITTED: "parameters were not refitted to whole records",
    R.NO_UNNAMED_TORQUE: "no unnamed torque",
    R.NOT_COMPARED_RECORDS: "records were not compared for their parameters",
    R.NO_DESIGNED_INPUT: "no input of a further record",
    # why an effect was not tried
    R.LINEAR_AXIS: "needs a shaft that turns: this axis is linear",
    R.NO_POSITION: "needs a measured position: the output is a velocity",
    R.REFUSED: "{why}",
    R.OUT_OF_TIME: "not tried, or not to the end: the time budget was used up",
    # criteria that are not met
    R.TOO_SMALL: "lowers the squared error too little",
    R.NOT_CONFIRMED: "does not make segments likelier that its parameters were not fitted to",
    R.UNCERTAIN_GAIN: "makes others so much less likely that its gain may be chance",
    R.NOT_COMPARED: (
        "gains far less than another effect, or only with values that are not credible"
    ),
    R.LESS_LIKELY: "explains the residual less well than another effect",
    R.REJECTED: "was rejected by the search",
    # rounds of the search
    R.TIE: "several effects explain the residual equally well",
    R.CHANCE: "no gain above the level that chance reaches",
    R.NOTHING_TO_ADD: "no effect can be added to this model",
    R.OUT_OF_BUDGET: "the time budget was used up",
    # doubts
    R.DOUBT_STRENGTH: "the strength of {effects} is not known to within a factor of {factor:g}",
    R.DOUBT_BOUND: "{parameters} ends at a limit of what it can be",
    R.DOUBT_ERROR: "the error on held-out segments does not fall by a factor of {factor:g}",
    R.DOUBT_WHOLE: "over longer times the model is worse than without",
    R.DOUBT_SIZE: "{parameters} is larger than hardware has",
    R.DOUBT_CANCELLING: "the torques of {effects} cancel each other in these records",
    R.DOUBT_FAINT: "the torque of {effects} is nowhere {share:.0%} of that of drive and friction",
    R.DOUBT_REST: "{share:.0%} of the residual can still be predicted",
    R.UNMET: "'{effect}' is significant, but {objection}",
    R.OTHERS_UNFINISHED: "'{effect}' is the best, but others were not tried to the end",
    R.UNKNOWN_STRENGTH: (
        "'{effect}' is significant, but beside what was found its strength is not known"
    ),
    R.FAINT: (
        "'{effect}' is significant, but its torque is nowhere {share:.0%} of that of drive and"
        " friction"
    ),
    R.NOT_SLIDING: "'{effect}' is significant, but gains nothing where the servo slides",
    R.ONLY_BOUNDS: "it only makes up for bounds",
    # views of the residual
    R.WAVE_IN_TIME: "{frequency:.3g} Hz",
    R.WAVE_ALONG_PATH: "{periods:.3g} in {path}",
    R.OUTLIER_SEGMENTS: "{segments} of {of} segments, the worst at {worst:.3g} s",
    # why nothing can be named
    R.LARGE_DISTURBANCE: (
        "the model needs a disturbance of {share:.0%} of the input to follow them; check columns,"
        " signs and units"
    ),
    # inputs of a further record
    R.MANY_STEPS: "steps of many sizes with rests, ramps and sweeps",
    R.SLOW_RAMPS: "slow ramps of the input through zero",
    R.RECORDED_INPUT: "a recorded input",
    R.QUICKENED_INPUT: "a recorded input, quickened",
    R.VARIED_INPUT: "a recorded input, its pace and size varied",
    # a plant FMU
    R.FMU_INPUT_UNIT: (
        "input {input} of {fmu} is in {unit}, that of the records in {of_records}, and was given"
        " their numbers: if one is not worth the other, export the FMU with that input or correct"
        " [input]"
    ),
    R.FMU_NOT_FOLLOWED: (
        "The search runs on a servo that is fitted to the FMU, and with {law} friction none comes"
        " near: it stays {error:.3g} {unit} rms from the FMU, and {left:.3g} {unit} from the"
        " records when refitted to them. What the FMU lacks cannot be seen behind that. Give a"
        " MODEL.toml with the FMU's own friction law, effects and parameters."
    ),
    R.FMU_BY_RECORD: (
        "{fmu} cannot be restarted at each segment ({why}): whole records were simulated from its"
        " start values"
    ),
    R.NO_START_VARIABLE: "no parameter {variable}_start and no start value of {variable}",
    # a proposed model file
    R.SEVERAL_COLUMNS: (
        "{columns} columns may be the {role}: '{chosen}' is taken, with which inertia and friction"
        " explain {explained:.0%} of the input; with '{other}' {other_explained:.0%}"
    ),
    R.UNEXPLAINED_INPUT: (
        "inertia and friction explain only {explained:.0%} of the input: are these the right"
        " columns?"
    ),
    R.POSITION_INPUT: (
        "inertia and friction explain only {explained:.0%} of the input; with a torque that follows"
        " the position, such as gravity or a spring, {beside:.0%}: diagnose looks for it. If there"
        " is none, are these the right columns?"
    ),
    R.SIGN_TURNED: (
        "a positive '{column}' moves the output backwards; its sign is turned by scale"
    ),
    R.NEVER_NEGATIVE: (
        "'{column}' is never negative while the input has both signs: was the speed measured"
        " without its sign?"
    ),
    R.SETPOINT_INPUT: (
        "no torque, force, voltage or current: the goal '{column}' is the input, through a"
        " controller with unknown gains; J = 1, and all else is relative to it"
    ),
    R.GUESSED_INERTIA: "the records hardly show the inertia; J is a guess",
}


def said(line: Line) -> str:
    """Return the words of a finding; text as it is."""
    if isinstance(line, str):
        return line
    facts = {key: _worded(fact) for key, fact in line.facts.items()}
    if line.reason in SENTENCES:
        return SENTENCES[line.reason].format(**facts)
    return WITH_CONDITIONS[line.reason](line.facts)


def _worded(fact: Any) -> Any:
    """Return a fact as it is put into a sentence."""
    if isinstance(fact, Finding):
        return said(fact)
    if isinstance(fact, tuple) and all(isinstance(each, str) for each in fact):
        return ", ".join(fact)
    return fact


# -- sentences with conditions ---------------------------------------------------------------------
Facts = dict[str, Any]


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def _coarse_input(facts: Facts) -> str:
    return (
        f"the input changes between samples that are {1e3 * facts['period']:.3g} ms apart; log it"
        " at the rate of the drive"
    )


def _advice(advice: str, facts: Facts) -> str:
    one = "correct this record, not the model file, which is right for the others"
    return one if facts["alone"] else advice


def _shares(facts: Facts) -> str:
    return f"explains {facts['explained']:.0%} of the torque, as given {facts['as_given']:.0%}"


def _implausible(facts: Facts) -> str:
    why = (
        "No effect was tried: data and model disagree in a way that is more likely a mistake in one"
        " of them. Proposed: "
    )
    proposed = "; ".join(said(line).rstrip(".") for line in facts["corrections"])
    return f"{why}{proposed}{'' if proposed.endswith('?') else '.'}"


def _other_output(facts: Facts) -> str:
    advice = _advice("correct [output] kind and unit", facts)
    return (
        f"output looks like a {facts['other']}, not a {facts['kind']}: that {_shares(facts)};"
        f" {advice}"
    )


def _swapped_columns(facts: Facts) -> str:
    first, second = facts["columns"]
    advice = _advice("swap them in the model file", facts)
    return (
        f"columns of input and output look swapped: '{first}' and '{second}' the other way round"
        f" {_shares(facts)}; {advice}"
    )


def _flipped_sign(facts: Facts) -> str:
    advice = (
        'reverse it with scale = "-1" beside the unit in [input], or in [output] if its sign is the'
        " wrong one"
    )
    return (
        f"input sign looks flipped: with -u the model {_shares(facts)} (J {facts['J']:.3g},"
        f" Fc {facts['Fc']:.3g}); {_advice(advice, facts)}"
    )


def _looks_off(what: str, factor: float) -> str:
    size = math.exp(abs(math.log(factor)))
    return f"{what} looks a factor {size:.3g} too {'large' if factor > 1 else 'small'}"


def _wrong_factor(facts: Facts) -> str:
    looks = [(facts["what"], facts["factor"]), *facts["others"]]
    ratios = ", ".join(f"{name} x{ratio:.3g}" for name, ratio in facts["ratios"])
    check = _advice(f"check the unit '{facts['unit']}' of column '{facts['column']}'", facts)
    causes = ", ".join(CAUSE_WORDS[cause](detail) for cause, detail in facts["causes"])
    return (
        f"{', or '.join(_looks_off(*each) for each in looks)}: against the nominal values {ratios};"
        f" {check}; possible causes: {causes}"
    )


def _unit_cause(unit: str) -> str:
    if not unit:
        return "a wrong unit"
    return f"a unit of {unit}" if unit in ("milli", "micro") else unit


CAUSE_WORDS: dict[str, Callable[[str], str]] = {  # of a wrong factor, from their details
    "unit": _unit_cause,
    "scale": lambda _: "a missing scale",
    "gear": lambda _: "a missing gear ratio",
    "gain": lambda per: f"a wrong b in [parameters], the {per}",
    "rotor": lambda kind: (
        f"a {kind} at the rotor ahead of a gear, with J that of the load behind it"
    ),
}


def _common_factor(facts: Facts) -> str:
    common = facts["factor"]
    shown = f"{common:.3g}" if common > 1 else f"1/{1 / common:.3g}"
    return (
        f"{' and '.join(facts['names'])} come out at {shown} of nominal alike: is the input a"
        " torque on the other side of a gear?"
    )


def _wider_bounds(facts: Facts) -> str:
    near = " and ".join(
        f"{name} near {value:.3g} {unit}, outside its bounds [{low:.4g}, {high:.4g}]"
        for name, value, unit, low, high in facts["parameters"]
    )
    better = "without any effect better than with effects within the bounds"
    return f"wider bounds, since the records fit {near}, {better}"


def _at_bound(facts: Facts) -> str:
    value, (low, high) = facts["value"], facts["bounds"]
    absent = value == 0.0 == low
    advice = "none is seen in these records" if absent else "widen it if it may be wrong"
    if not facts["still"]:
        advice = "with what was found it does not" + ("" if absent else f"; {advice}")
    where = f"its bound {value:.4g}{_unit(facts['unit'])} of [{low:.4g}, {high:.4g}]"
    return f"the base refit of {facts['name']} ends at {where}: {advice}"


def _one_after_the_other(facts: Facts) -> str:
    return (
        f"{' and '.join(facts['effects'])} by the time over the records one after the other, in the"
        f" order given: {', '.join(facts['records'])}"
    )


def _budget_used(facts: Facts) -> str:
    left = "; ".join(said(each) for each in facts["left_out"])
    return f"the time budget of {facts['seconds']:g} s was used up: {left}"


def _records_lack(facts: Facts) -> str:
    return f"the records lack {' and '.join(facts['what'])}"


def _sliding(facts: Facts) -> str:
    return (
        f"{_added(facts)}; it shows where the servo slides, by {facts['gain']:.0f} nats, and not in"
        " the simulated segments"
    )


def _added(facts: Facts) -> str:
    line = f"'{facts['effect']}' added"
    if facts.get("removed"):
        line += f"; removed, as no longer needed: {', '.join(facts['removed'])}"
    if not facts.get("structure", True):
        line += "; neither a view nor an effect shows structure in the residual"
    return line


def _bound(facts: Facts) -> str:
    ends = " and ".join(f"{key} at {value:.3g}" for key, value in facts["ends"])
    return (
        f"'{facts['effect']}' would explain most with {ends}, the end of what it can be: it stands"
        " in for something else"
    )


def _stands_in(facts: Facts) -> str:
    names: Sequence[str] = facts["effects"]
    effects = " and ".join(f"'{name}'" for name in names)
    they = "it stands" if len(names) == 1 else "they stand"
    return (
        f"{effects} would explain most, but with a strength that may be nothing: {they} in for"
        " something else"
    )


def _suspected(facts: Facts) -> str:
    names: Sequence[str] = facts["effects"]
    are = "is" if len(names) == 1 else "are"
    why = ", and ".join(said(doubt) for doubt in facts["doubts"])
    return f"{' and '.join(names)} {are} suspected, but {why}"


def _budget_before_all(facts: Facts) -> str:
    so_far = f"; so far, {said(facts['so_far'])}" if facts["so_far"] else ""
    return (
        f"the time budget was used up before {len(facts['effects'])} effects were tried to the"
        f" end{so_far}"
    )


def _fmu_followed(facts: Facts) -> str:
    servo, unit = " and ".join([f"{facts['law']} friction", *facts["effects"]]), facts["unit"]
    return (
        f"a servo with {servo} follows {facts['fmu']} to {facts['error']:.3g} {unit} rms; what was"
        f" measured is {facts['gap']:.3g} {unit} rms away from it"
    )


def _fmu_agrees(facts: Facts) -> str:
    gap, alone, unit = facts["gap"], facts["noise_floor"], facts["unit"]
    of_it = "as much" if alone >= gap else f"{alone:.3g} {unit} of it"
    return (
        f"{facts['fmu']} agrees with the records: rms {gap:.3g} {unit}; disturbance and sensor"
        f" alone give {of_it}."
    )


def _fmu_parameter(facts: Facts) -> str:
    value, seen, unit = facts["of_fmu"], facts["of_records"], _unit(facts["unit"])
    by = _excess(value / seen) if seen and value / seen > 0 else "wrong"
    low, high = facts["ci95"]
    bound = ", the bound of the search" if facts["at_bound"] else ""
    return (
        f"{facts['name']} of {facts['fmu']} looks {by}: it behaves like {value:.4g}{unit}, the"
        f" records like {seen:.4g}{unit} ({low:.4g} to {high:.4g}){bound}"
    )


def _excess(ratio: float) -> str:
    """Return a ratio in words."""
    way, size = ("high", ratio) if ratio > 1 else ("low", 1 / ratio)
    return f"{size:.1f} times too {way}" if size >= 2 else f"{abs(ratio - 1):.0%} too {way}"


def _fmu_by_segment(facts: Facts) -> str:
    return (
        f"{facts['fmu']} was {facts['way']} for each of {facts['segments']} segments,"
        f" {facts['lead']:.3g} s before it, with {' and '.join(facts['variables'])} as measured;"
        " its other states begin at their start values"
    )


def _fmu_own_start(facts: Facts) -> str:
    moved = " and moved onto what was measured" if facts["moved"] else ""
    how = f"whole records were simulated from its own start{moved}, and no shorter horizons"
    return f"{facts['fmu']} cannot be started from a measured state ({said(facts['why'])}): {how}"


WITH_CONDITIONS: dict[Reason, Callable[[Any], str]] = {
    R.COARSE_INPUT: _coarse_input,
    R.IMPLAUSIBLE: _implausible,
    R.OTHER_OUTPUT: _other_output,
    R.SWAPPED_COLUMNS: _swapped_columns,
    R.FLIPPED_SIGN: _flipped_sign,
    R.WRONG_FACTOR: _wrong_factor,
    R.WIDER_BOUNDS: _wider_bounds,
    R.COMMON_FACTOR: _common_factor,
    R.AT_BOUND: _at_bound,
    R.ONE_AFTER_THE_OTHER: _one_after_the_other,
    R.BUDGET_USED: _budget_used,
    R.RECORDS_LACK: _records_lack,
    R.ADDED: _added,
    R.SLIDING: _sliding,
    R.BOUND: _bound,
    R.STANDS_IN: _stands_in,
    R.SUSPECTED: _suspected,
    R.BUDGET_BEFORE_ALL: _budget_before_all,
    R.FMU_FOLLOWED: _fmu_followed,
    R.FMU_AGREES: _fmu_agrees,
    R.FMU_PARAMETER: _fmu_parameter,
    R.FMU_BY_SEGMENT: _fmu_by_segment,
    R.FMU_OWN_START: _fmu_own_start,
}
