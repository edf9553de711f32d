"""A program as C99 sources: generated model.h and model.c beside the fixed core.h and core.c."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from importlib.resources import files

from bristle.model.emit import emit_c
from bristle.model.program import Kernel, Program, Variant

KERNELS = ("derive", "start", "outputs", "before", "after", "modes", "step", "rates", "jacobian", "step_jacobian", "seen_jacobian")


def _list(values: Sequence[int]) -> str:
    return "{" + ", ".join(map(str, values or [-1])) + "}"


def _variant(variant: Variant) -> tuple[str, str]:
    """Return (tables, entry of VARIANTS) of one variant."""
    name = variant.system.name
    groups = {"states": variant.states, "ders": variant.ders, "finite": variant.finite}
    tables = "".join(f"static const int {name}_{group}[] = {_list(places)};\n" for group, places in groups.items())
    kept = variant.kept()
    pointers = [kept[k].name if k in kept else "0" for k in KERNELS]
    numbers = [len(variant.states), len(variant.finite), *(f"{name}_{group}" for group in groups)]
    places = [variant.sample_time, variant.max_step, variant.max_steps, variant.friction_step]
    return tables, "    {" + ", ".join(map(str, [*pointers, *numbers, *places])) + "}"


def fingerprint(program: Program) -> tuple[str, ...]:
    """Return texts that are the same where the sources are the same, far sooner than the sources: nothing is spelled out."""
    package = files("bristle.model")
    spelling = ((package / name).read_text(encoding="utf-8") for name in ("emit.py", "branches.py"))
    return (*spelling, *(text for pair in sorted(c_sources(program, _stored).items()) for text in pair))


def _stored(kernel: Kernel) -> str:
    """Return what stands for a kernel: its functions as CasADi stores them, and the places it reads and writes."""
    functions = [hashlib.sha256(function.serialize().encode()).hexdigest() for function, _ in kernel.blocks]
    return repr((kernel.name, functions, [tuple(targets) for _, targets in kernel.blocks], kernel.reads, kernel.to_output))


def c_sources(program: Program, spell: Callable[[Kernel], str] = emit_c) -> dict[str, str]:
    """Return file name -> text of everything that makes the program run, standing alone; `spell` gives that of a kernel."""
    most = max(len(a.states) for a in program.variants)
    jacobian = max(a.kernels["jacobian"].blocks[0][0].numel_out() if "jacobian" in a.kernels else 0 for a in program.variants)
    header = f"""/* {program.name}: {program.description} (generated) */
#ifndef BRISTLE_MODEL_H
#define BRISTLE_MODEL_H
#define N_V {len(program.slots)}
#define N_X {most}
#define N_VARIANTS {len(program.variants)}
#define N_JACOBIAN {jacobian}
#define N_SENSITIVITIES {len(program.sensitivities)}
#define N_OBSERVED {int(bool(program.sensitivities and program.observed))}
#define SELECTOR ({program.index[program.selector] if program.selector else -1})
#endif
"""
    body = [f"/* {program.name}: the equations (generated) */", '#include "core.h"', "#include <math.h>", ""]
    entries = []
    for variant in program.variants:
        body += [spell(kernel) for kernel in variant.kept().values()]
        tables, entry = _variant(variant)
        body.append(tables)
        entries.append(entry)
    body.append("const Variant VARIANTS[N_VARIANTS] = {\n" + ",\n".join(entries) + "\n};")
    body.append("const double START[N_V] = {" + ", ".join(repr(float(x)) for x in program.starts) + "};\n")
    folder = files("bristle.model") / "c"
    fixed = {name: (folder / name).read_text(encoding="utf-8") for name in ("core.h", "core.c")}
    return {"model.h": header, "model.c": "\n".join(body), **fixed}
