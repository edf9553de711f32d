"""README.md of an exported scenario: one page for who receives it."""

from __future__ import annotations

from bristle.harness.exchange.ssp import CSV_TYPE, SystemStructure


def readme(system: SystemStructure, name: str, tolerance: float, steps: int) -> str:
    """Return the page; `steps`: most of the run that an FMU holds."""
    parts = [each for each in system.components if each.type != CSV_TYPE]
    wiring = "\n".join(
        f"| {source}.{output} | {target}.{given} |"
        for (source, output), (target, given) in system.connections
    )
    listed = ", ".join(f"`fmus/{each.name}.fmu`" for each in parts)
    stop, step = system.stop or 0.0, system.step or 0.0
    short = min(stop, steps * step)
    tables = [each.source.rpartition("/")[2] for each in system.components if each.type == CSV_TYPE]
    noise = "".join(
        f"- `{each}`: inputs with noise, a row a step. Ecos and libcosim take no such table.\n"
        for each in tables
    )
    others = (
        f'- **Ecos** (Python): `EcosSimulation(ssp_path="{name}.ssp", step_size={step:g})`.\n-'
        f' **libcosim** (Python): `CosimExecution.from_ssp_file(ssp_path="{name}.ssp",'
        f" step_size={round(step * 1e9)})`, in ns.\n"
    )
    tried = "" if tables else others
    inside = "UNPACKED/extra/org.fmi-standard.fmi-ls-ref/validation-stimuli.csv"
    return f"""# {name}

A co-simulation of {len(parts)} FMUs, as `{name}.ssp` (System Structure and Parameterization 1.0)
and as files: {listed}. The parameters of the scenario are the start values of the FMUs, so that
nothing needs to be set; the package repeats them as parameter sets.

- Communication step {step:g} s, fixed, from 0 to {stop:g} s. In each step all FMUs read what the
  others had published before it (Jacobi); nothing is iterated.
- `reference/signals.csv`: what all outputs are, at equal steps in time. A tool with this scheme
  gives them to about {tolerance:g} of the range of each signal. Other schemes, such as one FMU
  after the other with values passed on within the step, shift signals by a step.
- `reference/verdict.json`: the checks of the scenario with their values, and the estimates with true values and errors. What begins
  with `validation.` is of a second run, which is not part of this.
{noise}
| output | input |
|---|---|
{wiring}

## Steps

Tried with packages of this kind:

- **bristle**: `bristle run {name}.ssp` runs it, compares it with the reference and says pass or
  fail. {tried} Not tried; as their manuals say:

- **OMSimulator**: `OMSimulator {name}.ssp`, or *File, Import, SSP* in OMEdit. The step stands in
  the package.
- **OpenModelica**: OMEdit, *File, Open Model*, choose `{name}.ssp`, simulate.
- **Dymola**: *File, Open, SSP*; or import the FMUs (*FMU, Import*, Co-Simulation) and connect them
  as in the table.
- **Simulink**: one *FMU* block (Simulink Block Library) for each file, sample time {step:g},
  connected as in the table, with a *Unit Delay* in each loop that Simulink reports as algebraic.

One FMU alone: each holds inputs and reference of its part of this run in
`extra/org.fmi-standard.fmi-ls-ref` (FMI-LS-REF).

- **bristle**: `bristle run fmus/plant.fmu` repeats it and says pass or fail.
- **FMPy** (tried): unpack the FMU, then `fmpy simulate fmus/plant.fmu --stop-time {short:g}
  --output-interval {step:g} --input-file {inside} --output-file out.csv` and compare with
  `validation-reference.csv` beside that file.
- **fmusim** (Reference FMUs; not tried):
  `fmusim --interface-type cs --stop-time {short:g} --input-file {inside} fmus/plant.fmu`.
"""
