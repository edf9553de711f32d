"""Programs without a compiler: generated Python or CasADi functions for `runtime.Core`, and
functions of arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from bristle.model.emit import emit_numpy, emit_python
from bristle.model.program import Kernel, Program
from bristle.model.sources import KERNELS

Array = NDArray[np.float64]
BLOCK = 8192  # elements that are evaluated together: temporaries that stay in the processor's cache


def for_arrays(function: ca.Function) -> Callable[[Sequence[Array | float]], list[Array]]:
    """Return a function of one vector (k,) as one of k numbers or arrays of equal length, one
    operation for many elements.

    Some ten times as fast as CasADi's own evaluation, point by point. Divisions by zero give
    infinity or NaN, silently.
    """
    namespace: dict[str, Any] = {"np": np}
    exec(compile(emit_numpy(function, "evaluated"), f"<{function.name()}>", "exec"), namespace)

    def evaluated(v: Sequence[Array | float]) -> list[Array]:
        inputs = [np.asarray(each, dtype=float)[()] for each in v]
        length = max((len(x) for x in inputs if x.ndim), default=1)
        with np.errstate(all="ignore"):
            blocks = [
                namespace["evaluated"]([x[first : first + BLOCK] if x.ndim else x for x in inputs])
                for first in range(0, max(length, 1), BLOCK)
            ]
        return [
            np.concatenate(parts) if np.ndim(parts[0]) else np.asarray(parts[0])
            for parts in zip(*blocks, strict=True)
        ]

    return evaluated


def python_source(program: Program) -> str:
    """Return a module text with START, CHOICE and VARIANTS, which imports nothing but math."""
    text = [f'"""{program.name}: the equations (generated)."""', "", "import math", "", ""]
    entries = []
    for variant in program.variants:
        kept = variant.kept()
        text += [emit_python(kernel) for kernel in kept.values()]
        pairs = [f'"name": "{variant.system.name}"']
        pairs += [f'"{n}": {kept[n].name if n in kept else None}' for n in KERNELS]
        pairs += [f'"{n}": {list(getattr(variant, n))}' for n in ("states", "ders", "finite")]
        pairs += [
            f'"{n}": {getattr(variant, n)}'
            for n in ("sample_time", "max_step", "max_steps", "friction_step")
        ]
        entries.append("    {" + ", ".join(pairs) + "},")
    text += [f"START = {program.starts!r}", f"CHOICE = {program.choice}"]
    return "\n".join([*text, "VARIANTS = [", *entries, "]", ""])


def python_tables(program: Program) -> SimpleNamespace:
    """Return the generated Python module as a namespace for `runtime.Core`."""
    namespace: dict[str, Any] = {}
    exec(compile(python_source(program), f"<{program.name}>", "exec"), namespace)
    return SimpleNamespace(**{k: namespace[k] for k in ("START", "CHOICE", "VARIANTS")})


def _evaluator(kernel: Kernel) -> Callable[[list[float], float, list[float] | None], None]:
    def run(v: list[float], h: float, out: list[float] | None) -> None:
        for function, targets in kernel.blocks:
            result = np.asarray(function(np.array([v[i] for i in kernel.reads]), h)).ravel()
            into = out if kernel.to_output else v
            assert into is not None
            for place, value in zip(targets, result, strict=True):
                into[place] = float(value)

    return run


def casadi_tables(program: Program) -> SimpleNamespace:
    """Return the program's functions as CasADi evaluates them, for `runtime.Core`: an independent
    arithmetic.
    """
    variants = []
    for variant in program.variants:
        entry: dict[str, Any] = {"name": variant.system.name}
        kept = variant.kept()
        entry |= {name: _evaluator(kept[name]) if name in kept else None for name in KERNELS}
        entry |= {n: list(getattr(variant, n)) for n in ("states", "ders", "finite")}
        entry |= {
            n: getattr(variant, n)
            for n in ("sample_time", "max_step", "max_steps", "friction_step")
        }
        variants.append(entry)
    return SimpleNamespace(START=program.starts, CHOICE=program.choice, VARIANTS=variants)
