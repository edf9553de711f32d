"""Every mistake in a scenario file is one line that names the file, the key, the value and what is
allowed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from bristle.harness.run.run import build_and_check
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.scenario.plan import identification, prepare
from bristle.harness.scenario.reading import load

Maker = Callable[..., Path]
Message = Callable[[Callable[[], object]], str]


def read(path: Path, *overrides: str, seed: int | None = None) -> object:
    loaded = load(path, overrides, seed)
    return identification(prepare(loaded, build_fmus(loaded)))


MISTAKES = [
    # what to replace, by what, what the line must say
    (
        "unknown key",
        'step = "1 ms"',
        'stepp = "1 ms"',
        ["stepp", "unknown key", "did you mean 'step'", "duration"],
    ),
    (
        "unknown key inside",
        'law = "modified"',
        'law = "modified"\nlwa = 1',
        ["plant.lwa", "allowed here", "law"],
    ),
    ("missing unit", '"2 s"', '"2"', ["duration", "has no unit", '"2 s"']),
    ("bare number", '"2 s"', "2", ["duration", "has no unit"]),
    ("wrong dimension", '"2 s"', '"2 kg"', ["duration", "'kg' does not fit", "'s'"]),
    ("unknown unit", '"2 s"', '"2 fortnights"', ["duration", "fortnights", "known"]),
    ("negative duration", '"2 s"', '"-2 s"', ["duration", "-2 s", "longer than 0 s"]),
    ("duration no multiple", '"2 s"', '"2.0005 s"', ["duration", "whole number of steps"]),
    ("duration too long", '"2 s"', '"1000000 s"', ["duration", "allowed are 5000000"]),
    ("duration missing", 'duration = "2 s"', "", ["duration is missing"]),
    (
        "parameter outside",
        "0.001 kg.m2",
        "-1 kg.m2",
        ["plant.parameters.J", "-1 kg.m2", "outside [1e-09, 1e+06] kg.m2"],
    ),
    (
        "parameter unknown",
        "J = ",
        "sigma0 = ",
        ["plant.parameters.sigma0", "no such parameter", "modified.sigma0"],
    ),
    (
        "parameter of another law",
        "J = ",
        '"lugre.Fc" = "1 N.m"\nJ = ',
        [
            "plant.parameters.lugre.Fc = \"1 N.m\": belongs to law 'lugre', this is 'modified';"
            " remove it"
        ],
    ),
    (
        "parameter of another method",
        'method = "bastin_gevers"',
        'method = "bastin_gevers"\nparameters = {"rls.memory" = "1 s"}',
        ["observer.parameters.rls.memory", "belongs to method 'rls', this is 'bastin_gevers'"],
    ),
    (
        "parameter of dry laws outside",
        "J = ",
        '"solver.friction_step" = "-1 s"\nJ = ',
        ['plant.parameters.solver.friction_step = "-1 s"', "outside"],
    ),
    (
        "parameter unit",
        "0.001 kg.m2",
        "0.001 kg.m",
        ["plant.parameters.J", "does not fit", "kg.m2"],
    ),
    ("parameter not finite", "0.001 kg.m2", "nan kg.m2", ["plant.parameters.J", "not finite"]),
    (
        "unknown law",
        '"modified"',
        '"modifed"',
        ["plant.law", "modifed", "did you mean 'modified'", "coulomb"],
    ),
    (
        "unknown observer",
        '"bastin_gevers"',
        '"kalman"',
        ["observer.method", "kalman", "choose one of", "rls"],
    ),
    ("no observer", '[observer]\nmethod = "bastin_gevers"', "", ["observer", "missing"]),
    (
        "law and fmu",
        'law = "modified"',
        'law = "modified"\nfmu = "x.fmu"',
        ["[plant] needs either law or fmu; both are given"],
    ),
    ("sensor", 'step = "1 ms"', 'sensor = "radar"', ["sensor", "radar", "clean", "encoder"]),
    (
        "no checks",
        '[[checks]]\nquantity = "estimates.b.error_percent"\nmax_abs = 1e6',
        "",
        ["checks", "missing"],
    ),
    ("check without limit", "max_abs = 1e6", "", ["checks[0]", "no limit"]),
    (
        "check that nothing meets",
        "max_abs = 1e6",
        "min = 3.0\nmax = 1.0",
        ["checks[0]", "no number is at least 3 and at most 1"],
    ),
    (
        "check beyond its range",
        "max_abs = 1e6",
        "max_abs = 2.0\nmax = -3.0",
        ["no number is at least -2 and at most -3"],
    ),
    (
        "check with text",
        "max_abs = 1e6",
        'max_abs = "small"',
        ["checks[0].max_abs", "small", "number"],
    ),
    ("not TOML", "[plant]", "[plant", ["not valid TOML", "line"]),
    (
        "stimulus",
        "[[checks]]",
        '[[stimuli]]\nvariable = "load"\npoints = [["0 s", 1.0]]\n[[checks]]',
        ["stimuli[0].variable", "load_scale"],
    ),
    (
        "stimulus of u and controller",
        "[observer]",
        '[controller]\n[[stimuli]]\nvariable = "u"\npoints = [["0 s", "1 V"]]\n[observer]',
        ["replaces the controller", "remove [controller]"],
    ),
    (
        "two stimuli of one input",
        "[[checks]]",
        (
            '[[stimuli]]\nvariable = "load_scale"\npoints = [["0 s", 1.0]]\n'
            '[[stimuli]]\nvariable = "load_scale"\npoints = [["1 s", 2.0]]\n[[checks]]'
        ),
        ["stimuli[1].variable", "put all points into one"],
    ),
    (
        "half an order",
        "[observer]",
        "[controller.parameters]\norder = 1.5\n[observer]",
        ["controller.parameters.order", "whole number"],
    ),
    (
        "stimulus of an output",
        "[[checks]]",
        '[[stimuli]]\nvariable = "v"\npoints = [["0 s", 1.0]]\n[[checks]]',
        ["no free input"],
    ),
    (
        "stimulus order",
        "[[checks]]",
        '[[stimuli]]\nvariable = "load_scale"\npoints = [["1 s", 1.0], ["1 s", 2.0]]\n[[checks]]',
        ["stimuli[0].points[1]", "increase"],
    ),
    (
        "stimulus value",
        "[[checks]]",
        '[[stimuli]]\nvariable = "load_scale"\npoints = [["0 s", -1.0]]\n[[checks]]',
        ["stimuli[0].points[0]", "outside [0"],
    ),
    (
        "record and plant",
        "[observer]",
        (
            '[record]\nfile = "x.csv"\ntime = {column = "t", unit = "s"}\n'
            'input = {column = "u", kind = "voltage", unit = "V"}\n'
            'output = {column = "v", kind = "velocity", unit = "rad/s"}\n[observer]'
        ),
        ["either [plant] or [record]"],
    ),
    (
        "seed zero",
        "[observer]",
        "[validation]\nseed = 0\n[observer]",
        ["validation.seed", "0", "at least 1"],
    ),
    (
        "foreign FMU missing",
        'law = "modified"\n\n[plant.parameters]\nJ = "0.001 kg.m2"',
        'fmu = "nowhere.fmu"',
        ["plant.fmu", "nowhere.fmu", "No such file"],
    ),
    (
        "foreign FMU broken",
        'law = "modified"\n\n[plant.parameters]\nJ = "0.001 kg.m2"',
        'fmu = "case.toml"',
        ["plant.fmu", "not a zip archive"],
    ),
]


@pytest.mark.parametrize(
    ("old", "new", "words"), [m[1:] for m in MISTAKES], ids=[m[0] for m in MISTAKES]
)
def test_a_mistake_is_one_line_with_file_key_and_remedy(
    old: str, new: str, words: list[str], base: str, scenario_file: Maker, message: Message
) -> None:
    assert old in base
    path = scenario_file(base.replace(old, new, 1))
    line = message(lambda: read(path))
    assert line.startswith(f"{path}: ")
    for word in words:
        assert word in line, line


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ("", "observer, plant or record, checks"),
        ('[plant]\nlaw = "modified"\n', "observer, checks"),
        (
            '[observer]\nmethod = "rls"\n[[checks]]\nquantity = "steps"\nmin = 1\n',
            "plant or record",
        ),
        ('[record]\nfile = "r.csv"\n', "observer, record.time, record.input, record.output"),
    ],
)
def test_all_missing_keys_are_told_at_once(
    text: str, keys: str, scenario_file: Maker, message: Message
) -> None:
    path = scenario_file(text)
    assert (
        message(lambda: load(path))
        == f"{path}: {keys}: missing; add {'them' if ',' in keys else 'it'}"
    )


def test_only_a_record_needs_no_checks(base: str, scenario_file: Maker, message: Message) -> None:
    record = (
        '[record]\nfile = "r.csv"\ntime = {column = "t", unit = "s"}\ninput = {column = "u", kind ='
        ' "force", unit = "N"}\noutput = {column = "v", kind = "velocity", unit ='
        ' "m/s"}\n[observer]\nmethod = "rls"\n'
    )
    assert load(scenario_file(record)).scenario.checks == []
    path = scenario_file(
        base.partition("[[checks]]")[0].replace("duration", "checks = []\nduration", 1)
    )
    assert message(lambda: load(path)) == f"{path}: checks: missing; add it"


@pytest.mark.parametrize(
    ("quantity", "words"),
    [
        (
            "estimates.b.eror_percent",
            "no number of the result (did you mean 'estimates.b.error_percent'?)",
        ),
        ("estimates.beta.final", "no number of the result (did you mean"),
        ("states.v.late_rsm", "no number of the result (did you mean 'states.v.late_rms'?)"),
        (
            "verdict",
            "no number of the result; choose one of the check quantities in the scenario reference",
        ),
        ("validation.mse_percent", "the scenario has no [validation]"),
        ("record.samples", "the scenario has no [record]"),
        (
            "estimates.sigma0.error_percent",
            (
                "the method bastin_gevers does not estimate sigma0; it estimates alpha2, b, Fc,"
                " load, delay: check one of these"
            ),
        ),
        (
            "states.w.rms",
            "the method bastin_gevers does not estimate w; it estimates v: check one of these",
        ),
    ],
)
def test_a_check_of_a_number_that_there_is_not_is_refused(
    quantity: str, words: str, base: str, scenario_file: Maker, message: Message, tmp_path: Path
) -> None:
    path = scenario_file(base.replace("estimates.b.error_percent", quantity))
    text = message(lambda: build_and_check(path, tmp_path / "out"))
    assert text.startswith(f'{path}: checks[0].quantity = "{quantity}": {words}')
    assert not (tmp_path / "out").exists()


def test_the_unchanged_file_is_accepted(base: str, scenario_file: Maker) -> None:
    read(scenario_file(base))


def test_missing_file_and_no_text(tmp_path: Path, message: Message) -> None:
    assert "No such file" in message(lambda: load(tmp_path / "nowhere.toml"))
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    assert "not UTF-8" in message(lambda: load(tmp_path / "binary.toml"))


@pytest.mark.parametrize(
    "override",
    [
        "plant.parameters.modified.sigma0=700 1/s2",
        'plant.parameters."modified.sigma0"="700 1/s2"',
        "plant.parameters.modified.sigma0 = 700 1/s2",
    ],
)
def test_set_reaches_structured_names(override: str, base: str, scenario_file: Maker) -> None:
    plant = load(scenario_file(base), [override]).scenario.plant
    assert plant is not None
    assert plant.parameters["modified.sigma0"] == "700 1/s2"


def test_set_replaces_values_in_tables_and_lists(base: str, scenario_file: Maker) -> None:
    path = scenario_file(base)
    scenario = load(
        path,
        ["duration=3 s", "checks.0.max_abs=7", "sensor=encoder", "validation.baselines=false"],
        seed=5,
    ).scenario
    assert (scenario.duration, scenario.checks[0].max_abs, scenario.sensor) == (3.0, 7.0, "encoder")
    assert scenario.validation is not None
    assert not scenario.validation.baselines
    assert scenario.controller.parameters["seed"] == 5


@pytest.mark.parametrize(
    ("override", "word"),
    [
        ("duration", "not path=value"),
        ("checks.5.max=1", "no index"),
        ("duration.x=1", "not a table"),
        ("plant.lawn=1", "unknown key"),
    ],
)
def test_a_wrong_override_is_one_line(
    override: str, word: str, base: str, scenario_file: Maker, message: Message
) -> None:
    path = scenario_file(base)
    assert word in message(lambda: load(path, [override]))


def test_quoted_and_nested_parameter_names_mean_the_same(base: str, scenario_file: Maker) -> None:
    quoted = load(
        scenario_file(base.replace("J = ", '"modified.c" = "99 1/rad"\nJ = '), "a")
    ).scenario.plant
    nested = load(
        scenario_file(base.replace("J = ", 'modified.c = "99 1/rad"\nJ = '), "b")
    ).scenario.plant
    assert quoted == nested


def test_a_scenario_gives_what_some_laws_read_and_keeps_it_when_the_law_changes(
    base: str, scenario_file: Maker
) -> None:
    path = scenario_file(base.replace("J = ", '"solver.friction_step" = "2e-4 s"\nJ = '))
    read = []
    for law in ("modified", "coulomb"):
        loaded = load(path, [f"plant.law={law}"])
        read.append(prepare(loaded, build_fmus(loaded)).values["plant"].get("solver.friction_step"))
    assert read == [None, 2e-4]


def test_stimuli_start_with_the_step_they_fall_on(base: str, scenario_file: Maker) -> None:
    text = base.replace(
        "[[checks]]",
        '[[stimuli]]\nvariable = "load_scale"\npoints = [["0 s", 1.0], ["0.5 s", 2.0], ["1.0001 s",'
        " 3.0]]\n[[checks]]",
    )
    loaded = load(scenario_file(text))
    events = identification(prepare(loaded, build_fmus(loaded))).events
    assert [(step, value) for step, _, value in events] == [(0, 1.0), (500, 2.0), (1001, 3.0)]
