"""README.md of an exported scenario: one page for who receives it."""

from __future__ import annotations

from bristle.harness.ssp import CSV_TYPE, SystemStructure


def readme(system: SystemStructure, name: str, tolerance: float) -> str:
    """Return the page."""
    parts = [each for each in system.components if each.type != CSV_TYPE]
    wiring = "\n".join(f"| {source}.{output} | {target}.{given} |" for (source, output), (target, given) in system.connections)
    listed = ", ".join(f"`fmus/{each.name}.fmu`" for each in parts)
    stop, step = system.stop or 0.0, system.step or 0.0
    return f"""# {name}

A co-simulation of {len(parts)} FMUs, as `{name}.ssp` (System Structure and Parameterization 1.0) and as files: {listed}.
The parameters of the scenario are the start values of the FMUs, so that nothing needs to be set; the package repeats them as
parameter sets.

- Communication step {step:g} s, fixed, from 0 to {stop:g} s. In each step all FMUs read what the others had published before it
  (Jacobi); nothing is iterated.
- `reference/signals.csv`: what all outputs are, at equal steps in time. A tool with this scheme gives them to about {tolerance:g}
  of the range of each signal. Other schemes, such as one FMU after the other with values passed on within the step, shift
  signals by a step.
- `reference/verdict.json`: the checks of the scenario with their values, and the estimates with true values and errors.

| output | input |
|---|---|
{wiring}

## Steps

- **bristle**: `bristle run {name}.ssp` runs it, compares it with the reference and says pass or fail.
- **OMSimulator**: `OMSimulator {name}.ssp`, or *File, Import, SSP* in OMEdit. The step stands in the package.
- **OpenModelica**: OMEdit, *File, Open Model*, choose `{name}.ssp`, simulate.
- **Dymola**: *File, Open, SSP*; or import the FMUs (*FMU, Import*, Co-Simulation) and connect them as in the table.
- **Simulink**: one *FMU* block (Simulink Block Library) for each file, sample time {step:g}, connected as in the table, with a
  *Unit Delay* in each loop that Simulink reports as algebraic.
- **FMPy**: `fmpy simulate fmus/plant.fmu --stop-time 1` runs one FMU alone; the loop is a few lines of Python (`fmpy.fmi2`).
- **fmusim** (Reference FMUs): `fmusim --interface-type cs --stop-time 1 fmus/plant.fmu`, one FMU alone.
"""
