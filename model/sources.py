"""A program as C sources: generated model.h, model.c and a file a variant beside core.h and core.c;
or one for lanes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import lru_cache
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

import casadi as ca

from bristle.common.cache import digest
from bristle.model.emit import emit_c, emit_lanes
from bristle.model.program import Program, Variant
from bristle.model.system import System

SX = ca.SX

# of lanes
WIDE_KERNELS = (
    "derive",
    "start",
    "outputs",
    "before",
    "after",
    "modes",
    "step",
    "step_jacobian",
    "seen_jacobian",
)
KERNELS = (
    "derive",
    "start",
    "outputs",
    "before",
    "after",
    "modes",
    "step",
    "rates",
    "jacobian",
    "step_jacobian",
)


def _list(values: Sequence[int]) -> str:
    return "{" + ", ".join(map(str, values or [-1])) + "}"


def _variant(
    variant: Variant,
    kernels: Sequence[str] = KERNELS,
    lists: Sequence[str] = ("states", "ders", "finite"),
) -> tuple[str, str]:
    """Return (tables, entry of VARIANTS or WIDE) of one variant."""
    name = variant.system.name
    groups = {each: getattr(variant, each) for each in lists}
    tables = "".join(
        f"static const int {name}_{group}[] = {_list(places)};\n"
        for group, places in groups.items()
    )
    kept = variant.kept()
    pointers = [kept[k].name if k in kept else "0" for k in kernels]
    numbers = [len(variant.states), len(variant.finite), *(f"{name}_{group}" for group in groups)]
    places = [variant.sample_time, variant.max_step, variant.max_steps, variant.friction_step]
    return tables, "    {" + ", ".join(map(str, [*pointers, *numbers, *places])) + "}"


def fingerprint(program: Program) -> tuple[str, ...]:
    """Return texts that differ where the sources would, but are much quicker to make, since no
    function is generated.

    They are the equations as written, and the code that generates functions from them.
    """
    layout = repr(
        (
            program.name,
            program.description,
            program.selector,
            program.sensitivities,
            program.observed,
            program.slots,
        )
    )
    return (_code(), layout, *(_equations(variant.system) for variant in program.variants))


@lru_cache(maxsize=1)
def _code() -> str:
    """Return the hash of everything that turns equations into C."""
    package = files("bristle.model")
    texts = [
        path.read_text(encoding="utf-8")
        for folder in (package, package / "c")
        for path in _sources(folder)
    ]
    return digest(version("casadi"), *texts)


def _sources(folder: Traversable) -> list[Traversable]:
    return sorted(
        (path for path in folder.iterdir() if path.name.endswith((".py", ".c", ".h"))),
        key=lambda path: path.name,
    )


def _equations(system: System) -> str:
    """Return a system as text: all its fields, with expressions as CasADi stores them."""
    found: list[SX] = []
    text = repr(_plain(system, found))
    symbols = [system.time, *system.symbols.values(), *system.ends.values()]
    return f"{text} {ca.Function('system', symbols, found).serialize()}"


def _plain(value: Any, found: list[SX]) -> Any:
    """Return a value with its expressions replaced by numbers in `found`, where they are put."""
    if isinstance(value, SX):
        found.append(ca.densify(value))
        return f"expression {len(found)} of {value.shape}"
    if is_dataclass(value) and not isinstance(value, type):
        return [(field.name, _plain(getattr(value, field.name), found)) for field in fields(value)]
    if isinstance(value, Mapping):
        return [(key, _plain(each, found)) for key, each in value.items()]
    if isinstance(value, (list, tuple)):
        return [_plain(each, found) for each in value]
    return value


def _header(program: Program) -> str:
    most = max(len(a.states) for a in program.variants)
    jacobian = max(
        a.kernels["jacobian"].blocks[0][0].numel_out() if "jacobian" in a.kernels else 0
        for a in program.variants
    )
    selector, index, running = program.choice
    return f"""/* {program.name}: {program.description} (generated) */
#ifndef BRISTLE_MODEL_H
#define BRISTLE_MODEL_H
#define N_V {len(program.slots)}
#define N_X {most}
#define N_VARIANTS {len(program.variants)}
#define N_JACOBIAN {jacobian}
#define N_SENSITIVITIES {len(program.sensitivities)}
#define CHOICE {int(selector >= 0)} /* several variants: the places that choose one and tell which runs */
#define SELECTOR {max(selector, 0)}
#define INDEX {max(index, 0)}
#define RUNNING {max(running, 0)}
#endif
"""


def _fixed(*names: str) -> dict[str, str]:
    folder = files("bristle.model") / "c"
    return {name: (folder / name).read_text(encoding="utf-8") for name in names}


def c_sources(program: Program) -> dict[str, str]:
    """Return file name -> text of all C sources that the program needs to run without this library.

    Each variant is a file of its own, so that a compiler works at several of them at a time.
    """
    sources = {"model.h": _header(program), **_fixed("core.h", "core.c")}
    names = [variant.system.name for variant in program.variants]
    for name, variant in zip(names, program.variants, strict=True):
        tables, entry = _variant(variant)
        kept = variant.kept()
        kernels = [emit_c(kept[kernel]) for kernel in KERNELS if kernel in kept]
        head = [
            f"/* {program.name}, {name}: the equations (generated) */",
            '#include "core.h"',
            "#include <math.h>",
            "",
        ]
        sources[f"model_{name}.c"] = "\n".join(
            [*head, *kernels, tables, f"const Variant VARIANT_{name} =\n{entry};\n"]
        )
    table = ", ".join(f"&VARIANT_{name}" for name in names)
    start = ", ".join(repr(float(x)) for x in program.starts)
    sources["model.c"] = "\n".join(
        [
            f"/* {program.name}: its variants, and what variables start from (generated) */",
            '#include "core.h"',
            "",
            *(f"extern const Variant VARIANT_{name};" for name in names),
            f"const Variant *const VARIANTS[N_VARIANTS] = {{{table}}};",
            f"const double START[N_V] = {{{start}}};",
            "",
        ]
    )
    return sources


def lanes_sources(program: Program) -> dict[str, str]:
    """Return the same of a program with one variant, which steps several instances at once."""
    [variant] = program.variants
    kept = variant.kept()
    tables, entry = _variant(variant, WIDE_KERNELS, ("states", "finite"))
    body = [f"/* {program.name}: the equations, in lanes (generated) */", '#include "lanes.h"', ""]
    body += [emit_lanes(kept[name]) for name in WIDE_KERNELS if name in kept]
    body += [tables, f"const Wide WIDE =\n{entry};\n"]
    fitted = program.observed and program.sensitivities
    segments = ["segments.c", "follow.c"] if fitted else []
    return {
        "model.h": _header(program),
        "model.c": "\n".join(body),
        **_fixed("core.h", "lanes.h", "lanes.c", *segments),
    }
