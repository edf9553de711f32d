"""From a scenario to what is co-simulated: FMUs, start values, connections, stimuli."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

from bristle.common.errors import BristleError, suggest
from bristle.common.packages import offered
from bristle.fmus.alias import Mapped, alias
from bristle.fmus.host import Alias, Fmu, Value
from bristle.harness.cosim.loop import Bus, Instance, Port
from bristle.harness.scenario.rig import Rig
from bristle.harness.scenario.samples import Samples, read_samples
from bristle.harness.scenario.scenario import Loaded, Part, Plant, Scenario
from bristle.harness.scenario.stimuli import Signal, check_range, events, read_stimuli, series

Kind = Literal["native", "python"]

# Variables of the bus and their SI units; an FMU must have the `NEEDED_PORTS`.
BUS_PORTS = {
    "plant": {
        "inputs": {"u": "V", "tau_load": "N.m", "load_scale": "1"},
        "outputs": {"theta": "rad", "v": "rad/s", "F": "N.m", "theta_enc": "rad", "v_enc": "rad/s"},
    },
    "controller": {
        "inputs": {"y_v": "rad/s", "u_ff": "V", "reference_scale": "1"},
        "outputs": {"u": "V", "reference": "rad/s", "u_compensation": "V"},
    },
    "observer": {"inputs": {"u": "V", "y_theta": "rad", "y_v": "rad/s"}, "outputs": {}},
}
# unit of a plant: others it may have
UNITS_OF_RIGS = {"V": ("A", "N.m", "N"), "rad": ("m",), "rad/s": ("m/s",), "N.m": ("N",)}
NEEDED_PORTS = {"plant": ("u", "theta", "v"), "controller": ("y_v", "u"), "observer": ("u",)}
# which a stimulus may drive
FREE_INPUTS = {"plant": ("u", "tau_load", "load_scale"), "controller": ("u_ff", "reference_scale")}
# plant outputs: position, velocity
SENSOR_OUTPUTS = {"clean": ("theta", "v"), "encoder": ("theta_enc", "v_enc")}
WHOLE_PARAMETERS = {  # Real parameters that only take whole values
    "controller": ("seed", "order"),
    "plant": ("input_noise.seed", "encoder.counts"),
}
SELECTOR_PARAMETERS = {"plant": "law", "observer": "method"}  # parameter that chooses among several


@dataclass(frozen=True)
class Setup:
    """A scenario with the FMUs it runs on, every value checked against them."""

    loaded: Loaded
    fmus: dict[str, Fmu]
    values: dict[str, dict[str, Value]]
    samples: Samples | None
    h: float
    stimuli: tuple[Signal, ...] = ()
    timeout: float | None = None  # s that a simulation may take where an FMU comes from elsewhere

    @property
    def foreign(self) -> list[str]:
        """The units whose FMU comes from elsewhere."""
        return [name for name, fmu in self.fmus.items() if fmu.foreign]

    @property
    def scenario(self) -> Scenario:
        """The scenario."""
        return self.loaded.scenario

    @property
    def steps(self) -> int:
        """Number of communication steps."""
        return self.scenario.steps if self.samples is None else len(self.samples)

    @property
    def rig(self) -> Rig:
        """Units of the record, and the scales in which the observer reads it."""
        return Rig() if self.samples is None else self.samples.rig

    @property
    def sensor(self) -> tuple[str, str]:
        """The plant outputs that the observer gets: position, velocity."""
        return SENSOR_OUTPUTS[self.scenario.sensor]

    def ports(self, unit: str) -> tuple[Port, ...]:
        """Return what is recorded of a unit at every step."""
        fmu = self.fmus[unit]
        known = BUS_PORTS[unit]["outputs"]
        return tuple(
            (unit, name)
            for name in fmu.names("output")
            if fmu.is_real(name) and (unit == "observer" or name in known)
        )


def find_fmus(loaded: Loaded, fmi: int = 2, kind: Kind = "native") -> dict[str, Fmu]:
    """Return the FMUs a scenario needs, building those of bristle that are not in the cache."""
    scenario = loaded.scenario
    parts: dict[str, Part | None] = {"observer": scenario.observer}
    if scenario.plant is not None:
        parts = {
            "controller": None if scenario.open_loop else scenario.controller,
            "plant": scenario.plant,
            **parts,
        }
    found = {}
    for name, part in parts.items():
        if part is None:
            continue
        if part.fmu is None and part.variables:
            raise loaded.error(
                f"{name}.variables",
                None,
                f"names those of an FMU of your own; give {name}.fmu, or remove it",
            )
        if part.fmu is not None:
            found[name] = _foreign(loaded, name, part.fmu, part.variables)
        else:
            found[name] = _own(loaded, name, part, fmi, kind)
    return found


def _own(loaded: Loaded, name: str, part: Part, fmi: int, kind: Kind) -> Fmu:
    """Return an FMU of bristle: of all laws or methods, or of one alone if it has effects or there
    are some from outside.
    """
    from bristle.fmus.build import is_packaged, obtain, plugins_of

    selector = SELECTOR_PARAMETERS.get(name, "")
    choice: str | None = getattr(part, selector, None)
    effects = part.effects if isinstance(part, Plant) else []
    packaged = choice is not None and is_packaged(name, choice)
    alone = packaged or (choice is not None and plugins_of(name))
    if not alone and not effects:
        return Fmu(obtain(name, fmi=fmi, kind=kind))
    try:
        law, method = (choice if selector == option else None for option in ("law", "method"))
        return Fmu(obtain(name, fmi=fmi, kind=kind, law=law, method=method, effects=effects))
    except BristleError as error:
        raise loaded.error(
            f"{name}.{selector}" if packaged else name, choice if packaged else None, str(error)
        ) from None


def _foreign(loaded: Loaded, name: str, file: str, variables: Mapping[str, Mapped]) -> Fmu:
    aliases = {key: _alias(loaded, name, key, given) for key, given in variables.items()}
    try:
        fmu = Fmu(loaded.beside(file), True, aliases)
    except BristleError as error:
        raise loaded.error(f"{name}.fmu", file, str(error)) from None
    sides = BUS_PORTS[name]
    for needed in NEEDED_PORTS[name]:
        side = "input" if needed in sides["inputs"] else "output"
        if not fmu.has(needed, side) or not fmu.is_real(needed):
            have = ", ".join(fmu.names(side)) or "none"
            advice = f'name the one that is meant: [{name}.variables] {needed} = "..."'
            raise loaded.error(
                f"{name}.fmu",
                file,
                f"has no Real {side} '{needed}' (its {side}s: {have}); {advice}",
            )
    try:
        for variable, unit in {**sides["inputs"], **sides["outputs"]}.items():
            if variable in fmu.variables:
                fmu.check_si(
                    variable, unit, *(UNITS_OF_RIGS.get(unit, ()) if name == "plant" else ())
                )
    except BristleError as error:
        raise loaded.error(f"{name}.fmu", file, str(error)) from None
    return fmu


def _alias(loaded: Loaded, name: str, key: str, given: Mapped) -> Alias:
    """Return the variable of an FMU that a port of the bus, or an estimate of an observer, is to
    be.
    """
    where, sides = f"{name}.variables.{key}", BUS_PORTS[name]
    wanted = {**sides["inputs"], **sides["outputs"]}
    if key not in wanted and not (
        name == "observer" and key.rpartition("_")[2] in ("hat", "valid", "sd")
    ):
        raise loaded.error(
            where,
            given,
            f"no variable of the bus{suggest(key, list(wanted))}; known: {', '.join(wanted)}",
        )
    unit = wanted.get(key)
    units = (
        [] if unit is None else [unit, *(UNITS_OF_RIGS.get(unit, ()) if name == "plant" else ())]
    )
    try:
        return alias(given, units)
    except BristleError as error:
        raise loaded.error(where, given, str(error)) from None


def prepare(loaded: Loaded, fmus: dict[str, Fmu]) -> Setup:
    """Check a scenario against its FMUs and, where there is one, its record.

    Raises
    ------
    BristleError
        One line with file, key, value and what is allowed.
    """
    scenario, samples, h = loaded.scenario, None, loaded.scenario.step
    if scenario.record is not None:
        samples = read_samples(loaded)
        h = samples.h
        if fmus["observer"].foreign:  # made for who knows which speed: it reads the record as it is
            samples = replace(samples, rig=replace(samples.rig, angle=1.0, voltage=1.0))
    parts: dict[str, Part | None] = {
        "plant": scenario.plant,
        "controller": scenario.controller,
        "observer": scenario.observer,
    }
    rig = Rig() if samples is None else samples.rig
    values = {
        name: _period(fmus[name], h) | _values(loaded, name, part, fmus[name], rig)
        for name, part in parts.items()
        if part is not None and name in fmus
    }
    if samples is not None:
        setup = Setup(loaded, fmus, values, samples, h)
        _tell_resolution(setup, samples.resolution)
        return setup
    free = {
        name: (unit, fmus[unit])
        for unit, names in FREE_INPUTS.items()
        if unit in fmus
        for name in names
        if fmus[unit].has(name, "input")
    }
    stimuli = read_stimuli(loaded, free, h)
    setup = Setup(loaded, fmus, values, samples, h, stimuli)
    _check_sensors(setup)
    _tell_resolution(setup, _encoder_step(setup))
    validated = round(scenario.validation.duration / h) if scenario.validation else 0
    check_range(loaded, free, stimuli, max(setup.steps, validated), h)
    _check_compensation(setup)
    return setup


def _period(fmu: Fmu, h: float) -> dict[str, Value]:
    return {"sample_time": h} if fmu.has("sample_time", "parameter") else {}


def _others(fmu: Fmu, selector: str, choice: str | None) -> set[str]:
    """Return the laws or methods of an FMU that are not chosen; nothing of one without a choice."""
    return set(fmu.choices(selector)) - {choice} if choice is not None else set()


@lru_cache(maxsize=64)
def _own_parameters(fmu: Fmu, selector: str, choice: str | None) -> list[str]:
    """Return the parameters of an FMU without those of other laws or methods than the one
    chosen.
    """
    others = _others(fmu, selector, choice)
    return [
        parameter
        for parameter in fmu.names("parameter")
        if parameter not in (selector, f"{selector}_index")
        and parameter.partition(".")[0] not in others
    ]


def _values(loaded: Loaded, name: str, part: Part, fmu: Fmu, rig: Rig) -> dict[str, Value]:
    """Return the start values of a part: its choice of law or method, and the user's parameters,
    which are in units of the rig.
    """
    values: dict[str, Value] = {}
    selector = SELECTOR_PARAMETERS.get(name, "")
    choice = getattr(part, selector, None)
    if choice is not None and fmu.has(selector, "parameter"):
        choices = fmu.choices(selector)
        if choice not in choices:
            from bristle.fmus.build import VARIANT_KIND

            known = list(dict.fromkeys([*choices, *offered(VARIANT_KIND[name])]))
            message = (
                f"unknown {selector}{suggest(choice, known)}; choose one of: {', '.join(known)}"
            )
            raise loaded.error(f"{name}.{selector}", choice, message)
        values[selector] = choices[choice]
    own = _own_parameters(fmu, selector, choice)
    for key, given in part.parameters.items():
        if choice is not None and key == f"{selector}_index":
            raise loaded.error(
                f"{name}.parameters.{key}",
                given,
                f"the scenario chooses by {name}.{selector}; remove it",
            )
        try:
            values[key] = fmu.parameter(key, given, own, rig.written)
        except BristleError as error:
            raise loaded.error(f"{name}.parameters.{key}", given, str(error)) from None
        if key in WHOLE_PARAMETERS.get(name, ()) and values[key] != int(values[key]):
            raise loaded.error(f"{name}.parameters.{key}", given, "must be a whole number")
        owner = key.partition(".")[0]
        if owner != key and owner in _others(fmu, selector, choice):
            raise loaded.error(
                f"{name}.parameters.{key}",
                given,
                f"belongs to {selector} '{owner}', this is '{choice}'; remove it",
            )
    return values


def _check_sensors(setup: Setup) -> None:
    plant, scenario = setup.fmus["plant"], setup.scenario
    for key in ("sensor", "controller_sensor"):
        choice = getattr(scenario, key)
        for output in SENSOR_OUTPUTS[choice]:
            if not plant.has(output, "output"):
                raise setup.loaded.error(
                    key, choice, f"the plant has no output '{output}'; write {key} = \"clean\""
                )
    if not any(setup.fmus["observer"].has(name, "input") for name in ("y_theta", "y_v")):
        raise setup.loaded.error(
            "observer.fmu",
            str(setup.fmus["observer"].path),
            "has neither input y_theta nor y_v; add one",
        )


def _check_compensation(setup: Setup) -> None:
    """Refuse a compensation for which an FMU has no variables."""
    wanted = setup.scenario.controller.compensation
    if wanted == "none":
        return
    links = _compensation_links(setup)
    for (_, given), (_, taken) in links:
        units = setup.fmus["observer"].unit(given), setup.fmus["controller"].unit(taken)
        if units[0] != units[1]:
            message = (
                f"output {given} of the observer is in {units[0]}, the controller takes {taken} in"
                f" {units[1]}; make them equal"
            )
            raise setup.loaded.error("controller.compensation", wanted, message)
    if not links:
        message = (
            "the controller has no input P_hat for an output P_hat of the observer; give its FMU"
            " such inputs, or write none"
        )
        raise setup.loaded.error("controller.compensation", wanted, message)
    if wanted == "adapted" and not setup.fmus["observer"].has(wanted, "output"):
        raise setup.loaded.error(
            "controller.compensation",
            wanted,
            "the observer has no output 'adapted'; write \"valid\"",
        )


def _compensation_links(setup: Setup) -> list[tuple[Port, Port]]:
    """Return the links that lead estimates to the inputs of the controller with the same names, and
    to P_valid what counts.
    """
    observer, controller = setup.fmus["observer"], setup.fmus["controller"]
    wanted, links = setup.scenario.controller.compensation, []
    for hat in observer.names("output"):
        valid = f"{hat.removesuffix('_hat')}_valid"
        if hat.endswith("_hat") and controller.has(hat, "input"):
            links.append((("observer", hat), ("controller", hat)))
            counts = wanted if wanted == "adapted" else valid
            if observer.has(counts, "output") and controller.has(valid, "input"):
                links.append((("observer", counts), ("controller", valid)))
    return links


def _encoder_step(setup: Setup) -> float | None:
    """Return the step of the plant's encoder [rad], where the observer reads the encoder."""
    plant, counts = setup.fmus["plant"], "encoder.counts"
    if setup.scenario.sensor != "encoder" or not plant.has(counts, "parameter"):
        return None
    return 2 * math.pi / float(setup.values["plant"].get(counts, plant.start(counts)))


def _tell_resolution(setup: Setup, step: float | None) -> None:
    """Give the observer the step of the position sensor, where it asks for one and the user has not
    said otherwise.

    A method that reads a velocity is told the standard deviation of a difference of two rounded
    positions. Source: widrow2008 chapter 1.
    """
    if step is None:
        return
    observer, method = setup.fmus["observer"], getattr(setup.scenario.observer, "method", None)
    for name, value in {
        f"{method}.resolution": step,
        f"{method}.noise": step / setup.h / math.sqrt(6.0),
    }.items():
        if observer.has(name, "parameter") and (
            name.endswith("resolution") or observer.unit(name) == "rad/s"
        ):
            told = min(value * setup.rig.worth(observer.unit(name)), observer.interval(name)[1])
            setup.values["observer"].setdefault(name, told)


def _instances(setup: Setup, names: tuple[str, ...]) -> tuple[Instance, ...]:
    return tuple(Instance(name, setup.fmus[name], setup.values[name]) for name in names)


def _loop_links(setup: Setup) -> list[tuple[Port, Port]]:
    speed = SENSOR_OUTPUTS[setup.scenario.controller_sensor][1]
    return [(("plant", speed), ("controller", "y_v")), (("controller", "u"), ("plant", "u"))]


@lru_cache(maxsize=64)
def _plant_flags(plant: Fmu) -> tuple[Port, ...]:
    return tuple(("plant", name) for name in plant.variables if name.startswith("true."))


def identification(setup: Setup) -> Bus:
    """Return the bus on which the observer runs: with plant and controller, or on a record."""
    observer = setup.fmus["observer"]
    said = [
        name for name in observer.names("output") if name.endswith("_valid") or name == "adapted"
    ]
    flags = tuple(("observer", name) for name in said if not observer.is_real(name))
    if setup.samples is not None:
        samples, units = setup.samples, BUS_PORTS["observer"]["inputs"]
        columns = {"u": samples.u, "y_theta": samples.theta, "y_v": samples.v}
        read = {
            name: values * setup.rig.worth(units[name])
            for name, values in columns.items()
            if observer.has(name, "input")
        }
        return Bus(
            _instances(setup, ("observer",)),
            setup.steps,
            setup.h,
            series={("observer", name): values for name, values in read.items()},
            record=setup.ports("observer"),
            flags=flags,
            watch=("observer",),
        )
    driven = [] if setup.scenario.open_loop else ["controller"]
    links = [*_loop_links(setup), (("controller", "u"), ("observer", "u"))] if driven else []
    for source, to in zip(setup.sensor, ("y_theta", "y_v"), strict=True):
        if observer.has(to, "input"):
            links.append((("plant", source), ("observer", to)))
    if setup.scenario.controller.compensation != "none":
        links += _compensation_links(setup)
    return Bus(
        _instances(setup, (*driven, "plant", "observer")),
        setup.steps,
        setup.h,
        links=tuple(links),
        events=events(setup.stimuli),
        series=series(setup.stimuli, setup.steps, setup.h),
        record=tuple(port for unit in (*driven, "plant", "observer") for port in setup.ports(unit)),
        flags=_plant_flags(setup.fmus["plant"]) + flags,
        watch=("observer",),
    )


def uncompensated(setup: Setup) -> Bus:
    """Return the bus of the same run with the controller alone: nothing of the observer reaches
    it.
    """
    return Bus(
        _instances(setup, ("controller", "plant")),
        setup.steps,
        setup.h,
        links=tuple(_loop_links(setup)),
        events=events(setup.stimuli),
        series=series(setup.stimuli, setup.steps, setup.h),
        record=setup.ports("controller") + setup.ports("plant"),
    )


def validation(setup: Setup) -> Bus:
    """Return the bus of the second record: the same plant and controller, another seed, from rest,
    the last loads held.
    """
    demand = setup.scenario.validation
    assert demand is not None
    if not setup.fmus["controller"].has("seed", "parameter"):
        raise setup.loaded.error(
            "validation.seed",
            demand.seed,
            "the controller FMU has no parameter 'seed'; remove [validation]",
        )
    if demand.seed == setup.values["controller"].get(
        "seed", setup.fmus["controller"].start("seed")
    ):
        raise setup.loaded.error(
            "validation.seed",
            demand.seed,
            "is the seed of the identification record; choose another one",
        )
    loads = [stimulus.settled() for stimulus in setup.stimuli if stimulus.unit == "plant"]
    steps = round(demand.duration / setup.h)
    controller = Instance(
        "controller", setup.fmus["controller"], {**setup.values["controller"], "seed": demand.seed}
    )
    return Bus(
        (controller, *_instances(setup, ("plant",))),
        steps,
        setup.h,
        links=tuple(_loop_links(setup)),
        events=events(loads),
        series=series(loads, steps, setup.h),
        record=setup.ports("controller") + setup.ports("plant"),
    )
