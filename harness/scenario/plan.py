"""From a scenario to what is co-simulated: FMUs, start values, connections, stimuli."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

from bristle.common.errors import BristleError
from bristle.common.units import quantity
from bristle.fmus.host import Fmu, Value
from bristle.harness.cosim.bus import Bus, BusUnit, Port
from bristle.harness.cosim.ports import OBSERVER, PORTS, SENSOR_OUTPUTS
from bristle.harness.scenario.reading import Loaded
from bristle.harness.scenario.rig import Rig
from bristle.harness.scenario.samples import Samples, read_samples
from bristle.harness.scenario.scenario import PartTable, Scenario
from bristle.harness.scenario.stimuli import Signal, check_range, events, read_stimuli, series


@dataclass(frozen=True)
class RunSetup:
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
        known = PORTS[unit].outputs
        return tuple(
            (unit, name)
            for name in fmu.names("output")
            if fmu.is_real(name) and (unit == "observer" or name in known)
        )


def prepare(loaded: Loaded, fmus: dict[str, Fmu]) -> RunSetup:
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
    # the start values of all parts
    parts: dict[str, PartTable | None] = {
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
        setup = RunSetup(loaded, fmus, values, samples, h)
        _tell_resolution(setup, samples.resolution)
        return setup
    # the stimuli, and what can only be checked with them
    free = {
        name: (unit, fmus[unit])
        for unit, ports in PORTS.items()
        if unit in fmus
        for name in ports.free
        if fmus[unit].has(name, "input")
    }
    stimuli = read_stimuli(loaded, free, h)
    setup = RunSetup(loaded, fmus, values, samples, h, stimuli)
    _check_sensors(setup)
    _tell_resolution(setup, _encoder_step(setup))
    validated = round(scenario.validation.duration / h) if scenario.validation else 0
    check_range(loaded, free, stimuli, max(setup.steps, validated), h)
    _check_compensation(setup)
    return setup


def _period(fmu: Fmu, h: float) -> dict[str, Value]:
    return {"sample_time": h} if fmu.has("sample_time", "parameter") else {}


@lru_cache(maxsize=64)
def _own_parameters(fmu: Fmu, selector: str) -> list[str]:
    """Return the parameters of an FMU without those that choose a law or method."""
    return [name for name in fmu.names("parameter") if name not in (selector, f"{selector}_index")]


def _values(loaded: Loaded, name: str, part: PartTable, fmu: Fmu, rig: Rig) -> dict[str, Value]:
    """Return the start values of a part: the user's parameters, which are in units of the rig."""
    values: dict[str, Value] = {}
    selector = PORTS[name].selector
    choice = getattr(part, selector, None)
    own = _own_parameters(fmu, selector)
    for key, given in part.parameters.items():
        where = f"{name}.parameters.{key}"
        if choice is not None and key == f"{selector}_index":
            message = f"the scenario chooses by {name}.{selector}; remove it"
            raise loaded.error(where, given, message)
        # what another law or method alone reads is refused, what several share is not read here
        if choice is not None and key not in own and _is_shared(loaded, name, choice, key):
            continue
        try:
            values[key] = fmu.parameter(key, given, own, rig.written)
        except BristleError as error:
            raise loaded.error(where, given, str(error)) from None
        if key in PORTS[name].whole and values[key] != int(values[key]):
            raise loaded.error(where, given, "must be a whole number")
    return values


def _is_shared(loaded: Loaded, name: str, choice: str, key: str) -> bool:
    """Say whether other laws or methods share a parameter that the chosen one does not read.

    A scenario may give it: it is run with several laws then. Its value is checked.
    """
    from bristle.fmus.build import readers

    where, given = f"{name}.parameters.{key}", getattr(loaded.scenario, name).parameters[key]
    declarations, owner = readers(name, key), key.partition(".")[0]
    if owner in declarations:
        message = f"belongs to {PORTS[name].selector} '{owner}', this is '{choice}'; remove it"
        raise loaded.error(where, given, message)
    try:
        for declared in declarations.values():
            declared.check(quantity(given, declared.unit))
    except BristleError as error:
        raise loaded.error(where, given, str(error)) from None
    return bool(declarations)


def _check_sensors(setup: RunSetup) -> None:
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


def _check_compensation(setup: RunSetup) -> None:
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


def _compensation_links(setup: RunSetup) -> list[tuple[Port, Port]]:
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


def _encoder_step(setup: RunSetup) -> float | None:
    """Return the step of the plant's encoder [rad], where the observer reads the encoder."""
    plant, counts = setup.fmus["plant"], "encoder.counts"
    if setup.scenario.sensor != "encoder" or not plant.has(counts, "parameter"):
        return None
    return 2 * math.pi / float(setup.values["plant"].get(counts, plant.start(counts)))


def _tell_resolution(setup: RunSetup, step: float | None) -> None:
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


def _instances(setup: RunSetup, names: tuple[str, ...]) -> tuple[BusUnit, ...]:
    return tuple(BusUnit(name, setup.fmus[name], setup.values[name]) for name in names)


def _loop_links(setup: RunSetup) -> list[tuple[Port, Port]]:
    speed = SENSOR_OUTPUTS[setup.scenario.controller_sensor][1]
    return [(("plant", speed), ("controller", "y_v")), (("controller", "u"), ("plant", "u"))]


@lru_cache(maxsize=64)
def _plant_flags(plant: Fmu) -> tuple[Port, ...]:
    return tuple(("plant", name) for name in plant.variables if name.startswith("true."))


def identification(setup: RunSetup) -> Bus:
    """Return the bus on which the observer runs: with plant and controller, or on a record."""
    observer = setup.fmus["observer"]
    said = [
        name for name in observer.names("output") if name.endswith("_valid") or name == "adapted"
    ]
    flags = tuple(("observer", name) for name in said if not observer.is_real(name))
    return _on_record(setup, flags) if setup.samples is not None else _on_plant(setup, flags)


def _on_record(setup: RunSetup, flags: tuple[Port, ...]) -> Bus:
    """Return the bus of an observer that reads a record, in the units in which it does."""
    samples, observer = setup.samples, setup.fmus["observer"]
    assert samples is not None
    columns = {"u": samples.u, "y_theta": samples.theta, "y_v": samples.v}
    read = {
        ("observer", name): values * setup.rig.worth(OBSERVER.inputs[name])
        for name, values in columns.items()
        if observer.has(name, "input")
    }
    return Bus(
        _instances(setup, ("observer",)),
        setup.steps,
        setup.h,
        series=read,
        record=setup.ports("observer"),
        flags=flags,
        watch=("observer",),
    )


def _on_plant(setup: RunSetup, flags: tuple[Port, ...]) -> Bus:
    """Return the bus of an observer beside a plant that a controller or a stimulus drives."""
    driven = [] if setup.scenario.open_loop else ["controller"]
    units = (*driven, "plant", "observer")
    # the loop, what the observer measures of it, and what the controller takes from the observer
    links = [*_loop_links(setup), (("controller", "u"), ("observer", "u"))] if driven else []
    for source, to in zip(setup.sensor, ("y_theta", "y_v"), strict=True):
        if setup.fmus["observer"].has(to, "input"):
            links.append((("plant", source), ("observer", to)))
    if setup.scenario.controller.compensation != "none":
        links += _compensation_links(setup)
    return Bus(
        _instances(setup, units),
        setup.steps,
        setup.h,
        links=tuple(links),
        events=events(setup.stimuli),
        series=series(setup.stimuli, setup.steps, setup.h),
        record=tuple(port for unit in units for port in setup.ports(unit)),
        flags=_plant_flags(setup.fmus["plant"]) + flags,
        watch=("observer",),
    )


def uncompensated(setup: RunSetup) -> Bus:
    """Return the bus of the same run with the controller alone: no part of the observer acts."""
    return Bus(
        _instances(setup, ("controller", "plant")),
        setup.steps,
        setup.h,
        links=tuple(_loop_links(setup)),
        events=events(setup.stimuli),
        series=series(setup.stimuli, setup.steps, setup.h),
        record=setup.ports("controller") + setup.ports("plant"),
    )


def validation(setup: RunSetup) -> Bus:
    """Return the bus of the second record: the same plant and controller, another seed, from rest,
    the last loads held.
    """
    demand = setup.scenario.validation
    assert demand is not None
    # the seed must be there, and be another one
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
    # the last loads held, and the same units with another seed
    loads = [stimulus.settled() for stimulus in setup.stimuli if stimulus.unit == "plant"]
    steps = round(demand.duration / setup.h)
    controller = BusUnit(
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
