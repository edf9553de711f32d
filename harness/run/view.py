"""The signals of a run, whether simulated or recorded, and the truth where it is known."""

from __future__ import annotations

from bristle.harness.cosim.bus import Array, BusTrace
from bristle.harness.metrics.estimates import (
    courses,
    element_distances,
    estimates_state,
    of_same_elements,
    true_values,
)
from bristle.harness.scenario.plan import RunSetup


class RunView:
    """The signals of a run, whether simulated or recorded, and the truth where it is known."""

    def __init__(self, setup: RunSetup, trace: BusTrace) -> None:
        observer, rig = setup.fmus["observer"], setup.rig
        units = {name: observer.unit(name) for unit, name in trace.record if unit == "observer"}
        if setup.samples is not None:
            factors = {("observer", name): 1 / rig.worth(unit) for name, unit in units.items()}
            trace = trace.from_first_sample(factors)
        self.trace, self.time, self.rig = trace, trace.time, rig
        self.signals, self.sensed = self._signals(setup)
        # what the observer publishes: all of it, the states that it estimates, the parameters
        self.observed = {
            name: trace[unit, name] for unit, name in trace.record if unit == "observer"
        }
        self.estimated = {
            name: self.observed[f"{name}_hat"]
            for name in ("v", "F")
            if estimates_state(trace, name)
        }
        self.true = {} if setup.samples is not None else self._true(setup)
        self.units = {name.removesuffix("_hat"): rig.unit(unit) for name, unit in units.items()}
        self.published = courses(trace, self.units)
        self.friction = self._friction(setup)

    def _signals(self, setup: RunSetup) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return all signals but those of the observer, and position and velocity as it gets them;
        of a record, its columns.
        """
        trace, rows, samples = self.trace, len(self.trace.values), setup.samples
        if samples is not None:
            sensed = {"theta": samples.theta[:rows], "v": samples.v[:rows]}
            return {"u": samples.u[:rows], **sensed}, sensed
        signals = {name: trace[unit, name] for unit, name in trace.record if unit != "observer"}
        signals |= {each.variable: each.values(rows, setup.h) for each in setup.stimuli}
        ports = zip(("theta", "v"), setup.sensor, strict=True)
        return signals, {key: trace["plant", port] for key, port in ports}

    def columns(self) -> dict[str, Array]:
        """Return all signals at full rate, and for each estimate whether it is called valid."""
        return {
            **self.signals,
            **self.observed,
            **{f"{name}_valid": course.valid for name, course in self.published.items()},
        }

    def column_units(self, setup: RunSetup) -> dict[str, str]:
        """Return the unit of each of these signals."""
        if setup.samples is not None:
            own = {
                "u": self.rig.unit("V"),
                "theta": self.rig.unit("rad"),
                "v": self.rig.unit("rad/s"),
            }
        else:
            own = {
                name: setup.fmus[unit].unit(name)
                for unit, name in self.trace.record
                if unit != "observer"
            }
            own |= {
                each.variable: setup.fmus[each.unit].unit(each.variable) for each in setup.stimuli
            }
        observer = {
            name: self.rig.unit(setup.fmus["observer"].unit(name)) for name in self.observed
        }
        return {**own, **observer, **{f"{name}_valid": "1" for name in self.published}}

    def _true(self, setup: RunSetup) -> dict[str, Array]:
        """Return the true parameters under the plant's loads and of the observer's elements."""
        torque, inertia = self.signals.get("tau_load"), self._inertia(setup)
        load = 0.0 if torque is None or inertia is None else torque / inertia
        true = true_values(self.trace, self.signals.get("load_scale", 1.0), load)
        distances = [
            element_distances(setup.fmus[unit], setup.values[unit])
            for unit in ("plant", "observer")
        ]
        return of_same_elements(true, *distances)

    @staticmethod
    def _inertia(setup: RunSetup) -> float | None:
        """Return J of the plant, where it says what it is."""
        if setup.samples is not None or not setup.fmus["plant"].has("J", "parameter"):
            return None
        return float(setup.values["plant"].get("J", setup.fmus["plant"].start("J")))

    def _friction(self, setup: RunSetup) -> Array | None:
        """Return F/J of the plant, where the plant has both."""
        inertia = self._inertia(setup)
        return self.signals["F"] / inertia if inertia is not None and "F" in self.signals else None

    def states(self) -> dict[str, Array]:
        """Return the true states that an observer may estimate."""
        if not self.true:
            return {}
        states = {"v": self.signals["v"]}
        if self.friction is not None and "alpha2" in self.true:
            states["w"] = self.friction - self.true["alpha2"] * self.signals["v"]
        return states
