"""Print a kernel as C99, as C of several lanes, as plain Python or as NumPy.

One pass over its instructions, one table of spellings for each language.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from bristle.model.branches import Branch, Line, arranged
from bristle.model.program import Kernel


@dataclass(frozen=True)
class _Language:
    """Spelling of infinity, NaN and operations: operation -> text of its operands {0}, {1}."""

    nan: str
    inf: str
    operations: Mapping[int, str]


# A minimum or maximum propagates NaN in all languages.
_SHARED = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
}
_C = _Language(
    "NAN",
    "INFINITY",
    _SHARED
    | {
        ca.OP_LT: "{0} < {1}",
        ca.OP_LE: "{0} <= {1}",
        ca.OP_EQ: "{0} == {1}",
        ca.OP_NE: "{0} != {1}",
        ca.OP_NOT: "!{0}",
        ca.OP_AND: "({0} != 0) && ({1} != 0)",
        ca.OP_OR: "({0} != 0) || ({1} != 0)",
        ca.OP_IF_ELSE_ZERO: "{0} != 0 ? {1} : 0.0",
        ca.OP_SIGN: "(double)(({0} > 0) - ({0} < 0))",
        ca.OP_FMIN: "({0} < {1} || {0} != {0}) ? {0} : {1}",
        ca.OP_FMAX: "({0} > {1} || {0} != {0}) ? {0} : {1}",
        ca.OP_FABS: "fabs({0})",
        ca.OP_FLOOR: "floor({0})",
        ca.OP_CEIL: "ceil({0})",
        ca.OP_SQRT: "sqrt({0})",
        ca.OP_EXP: "exp({0})",
        ca.OP_LOG: "log({0})",
        ca.OP_SIN: "sin({0})",
        ca.OP_COS: "cos({0})",
        ca.OP_TANH: "tanh({0})",
        ca.OP_ATAN2: "atan2({0}, {1})",
        ca.OP_POW: "pow({0}, {1})",
        ca.OP_CONSTPOW: "pow({0}, {1})",
    },
)
# Values are vectors of one number a lane, conditions too; what has no instruction is called lane by
# lane: the same digits as in C.
_LANES = _Language(
    "NAN",
    "INFINITY",
    _SHARED
    | {
        ca.OP_ASSIGN: "ALL({0})",
        ca.OP_LT: "ONE(ALL({0}) < {1})",
        ca.OP_LE: "ONE(ALL({0}) <= {1})",
        ca.OP_EQ: "ONE(ALL({0}) == {1})",
        ca.OP_NE: "ONE(ALL({0}) != {1})",
        ca.OP_NOT: "ONE(ALL({0}) == 0)",
        ca.OP_AND: "ONE(TRUE({0}) & TRUE({1}))",
        ca.OP_OR: "ONE(TRUE({0}) | TRUE({1}))",
        ca.OP_IF_ELSE_ZERO: "KEPT(TRUE({0}), {1})",
        ca.OP_SIGN: "ONE(ALL({0}) > 0) - ONE(ALL({0}) < 0)",
        ca.OP_FMIN: "CHOSEN((ALL({0}) < {1}) | (ALL({0}) != {0}), {0}, {1})",
        ca.OP_FMAX: "CHOSEN((ALL({0}) > {1}) | (ALL({0}) != {0}), {0}, {1})",
        ca.OP_FABS: "each_fabs({0})",
        ca.OP_FLOOR: "each_floor({0})",
        ca.OP_CEIL: "each_ceil({0})",
        ca.OP_SQRT: "each_sqrt({0})",
        ca.OP_EXP: "each_exp({0})",
        ca.OP_LOG: "each_log({0})",
        ca.OP_SIN: "each_sin({0})",
        ca.OP_COS: "each_cos({0})",
        ca.OP_TANH: "each_tanh({0})",
        ca.OP_ATAN2: "each_atan2(ALL({0}), ALL({1}))",
        ca.OP_POW: "each_pow(ALL({0}), ALL({1}))",
        ca.OP_CONSTPOW: "each_pow(ALL({0}), ALL({1}))",
    },
)
_PYTHON = _Language(
    "math.nan",
    "math.inf",
    _SHARED
    | {
        ca.OP_LT: "float({0} < {1})",
        ca.OP_LE: "float({0} <= {1})",
        ca.OP_EQ: "float({0} == {1})",
        ca.OP_NE: "float({0} != {1})",
        ca.OP_NOT: "float(not {0})",
        ca.OP_AND: "float({0} != 0 and {1} != 0)",
        ca.OP_OR: "float({0} != 0 or {1} != 0)",
        ca.OP_IF_ELSE_ZERO: "{1} if {0} else 0.0",
        ca.OP_SIGN: "float(({0} > 0) - ({0} < 0))",
        ca.OP_FMIN: "{0} if ({0} < {1} or {0} != {0}) else {1}",
        ca.OP_FMAX: "{0} if ({0} > {1} or {0} != {0}) else {1}",
        ca.OP_FABS: "abs({0})",
        ca.OP_FLOOR: "float(math.floor({0}))",
        ca.OP_CEIL: "float(math.ceil({0}))",
        ca.OP_SQRT: "math.sqrt({0})",
        ca.OP_EXP: "math.exp({0})",
        ca.OP_LOG: "math.log({0})",
        ca.OP_SIN: "math.sin({0})",
        ca.OP_COS: "math.cos({0})",
        ca.OP_TANH: "math.tanh({0})",
        ca.OP_ATAN2: "math.atan2({0}, {1})",
        ca.OP_POW: "math.pow({0}, {1})",
        ca.OP_CONSTPOW: "math.pow({0}, {1})",
    },
)
_NUMPY = _Language(
    "np.nan",
    "np.inf",
    _SHARED
    | {
        ca.OP_LT: "0.0 + ({0} < {1})",
        ca.OP_LE: "0.0 + ({0} <= {1})",
        ca.OP_EQ: "0.0 + ({0} == {1})",
        ca.OP_NE: "0.0 + ({0} != {1})",
        ca.OP_NOT: "0.0 + ({0} == 0)",
        ca.OP_AND: "0.0 + (({0} != 0) & ({1} != 0))",
        ca.OP_OR: "0.0 + (({0} != 0) | ({1} != 0))",
        ca.OP_IF_ELSE_ZERO: "np.where({0} != 0, {1}, 0.0)",
        ca.OP_SIGN: "np.sign({0})",
        ca.OP_FMIN: "np.minimum({0}, {1})",
        ca.OP_FMAX: "np.maximum({0}, {1})",
        ca.OP_FABS: "np.abs({0})",
        ca.OP_FLOOR: "np.floor({0})",
        ca.OP_CEIL: "np.ceil({0})",
        ca.OP_SQRT: "np.sqrt({0})",
        ca.OP_EXP: "np.exp({0})",
        ca.OP_LOG: "np.log({0})",
        ca.OP_SIN: "np.sin({0})",
        ca.OP_COS: "np.cos({0})",
        ca.OP_TANH: "np.tanh({0})",
        ca.OP_ATAN2: "np.arctan2({0}, {1})",
        ca.OP_POW: "np.power({0}, {1})",
        ca.OP_CONSTPOW: "np.power({0}, {1})",
    },
)


def _number(value: float, spell: _Language) -> str:
    if math.isnan(value):
        return spell.nan
    if math.isinf(value):
        return f"-{spell.inf}" if value < 0 else spell.inf
    return (
        repr(float(value))
        if value >= 0 and math.copysign(1.0, value) > 0
        else f"({float(value)!r})"
    )


def _walk(
    function: ca.Function, reads: Sequence[int], spell: _Language
) -> tuple[list[Line], dict[int, str]]:
    """Return the assignments of a function and the name of each result."""
    lines: list[Line] = []
    current: dict[int, str] = {}  # what each work slot holds now; every value gets a fresh name
    results: dict[int, str] = {}
    loaded: dict[tuple[int, int], str] = {}
    for k in range(function.n_instructions()):
        op, out, inp = (
            function.instruction_id(k),
            function.instruction_output(k),
            function.instruction_input(k),
        )
        if op == ca.OP_OUTPUT:
            results[out[1]] = current[inp[0]]
        elif op == ca.OP_INPUT:
            key = (inp[0], inp[1])
            if key not in loaded:
                loaded[key] = f"a{len(lines)}"
                lines.append(Line(loaded[key], f"v[{reads[inp[1]]}]" if inp[0] == 0 else "h", ()))
            current[out[0]] = loaded[key]
        elif op == ca.OP_CONST:
            current[out[0]] = _number(function.instruction_constant(k), spell)
        else:
            if op not in spell.operations:
                raise NotImplementedError(
                    f"operation {op} of {function.name()} has no spelling; add it to model/emit.py"
                )
            name, operands = f"a{len(lines)}", [current[i] for i in inp]
            needs = tuple(each for each in operands if each.startswith("a"))
            branch = (
                operands if op == ca.OP_IF_ELSE_ZERO and len(needs) == len(operands) else ("", "")
            )
            lines.append(Line(name, spell.operations[op].format(*operands), needs, *branch))
            current[out[0]] = name
    return lines, results


@dataclass(frozen=True)
class _Dialect:
    """How C is written: the language, the type of a number, arguments of a kernel, a result that is
    stored, zero, a condition.
    """

    language: _Language
    number: str
    arguments: Mapping[str, str]
    stored: str
    zero: str
    condition: str


_PLAIN = _Dialect(
    _C,
    "double",
    {"v": "double *", "h": "double ", "out": "double *"},
    "{array}[{place}] = {value};",
    "0.0",
    "{0} != 0",
)
_WIDE = _Dialect(
    _LANES,
    "Number",
    {"v": "Number *", "h": "Number ", "out": "Number *", "on": "Mask "},
    "{array}[{place}] = CHOSEN(on, {value}, {array}[{place}]);",
    "ALL(0.0)",
    "ANY(TRUE({0}))",
)


def emit_c(kernel: Kernel) -> str:
    """Return the kernel as a C99 function ``void name(double *v, double h, double *out)``."""
    return _emit_c(kernel, _PLAIN)


def emit_lanes(kernel: Kernel) -> str:
    """Return it as ``void name(Number *v, Number h, Number *out, Mask on)``: several at once,
    results only of lanes that are on.
    """
    return _emit_c(kernel, _WIDE)


def _emit_c(kernel: Kernel, dialect: _Dialect) -> str:
    array, arguments = "out" if kernel.to_output else "v", dialect.arguments
    head = (
        "static void"
        f" {kernel.name}({', '.join(f'{kind}{name}' for name, kind in arguments.items())})"
    )
    text = [head, "{", f"    {' '.join(f'(void){name};' for name in arguments)}"]
    for function, targets in kernel.blocks:
        lines, results = _walk(function, kernel.reads, dialect.language)
        text.append("    {")
        text += _statements(arranged(lines, set(results.values())), (), "        ", dialect)
        stored = (
            dialect.stored.format(array=array, place=targets[k], value=results[k])
            for k in sorted(results)
        )
        text += [f"        {line}" for line in stored]
        text.append("    }")
    return "\n".join([*text, "}", ""])


def _statements(
    lines: Sequence[Line | Branch], shown: Collection[str], indent: str, dialect: _Dialect
) -> list[str]:
    """Return the lines as C; those in `shown` are declared outside."""
    text, number = [], dialect.number
    for line in lines:
        if isinstance(line, Line):
            text.append(
                f"{indent}{'' if line.name in shown else f'const {number} '}{line.name} ="
                f" {line.text};"
            )
            continue
        if fresh := [name for name in line.shown if name not in shown]:
            text.append(
                f"{indent}{number} {', '.join(f'{name} = {dialect.zero}' for name in fresh)};"
            )
        inner = _statements(line.lines, {*shown, *line.shown}, indent + "    ", dialect)
        text += [
            f"{indent}if ({dialect.condition.format(line.condition)}) {{",
            *inner,
            f"{indent}}}",
        ]
    return text


def emit_python(kernel: Kernel) -> str:
    """Return the kernel as a Python function ``name(v, h, out)``."""
    array = "out" if kernel.to_output else "v"
    text = [f"def {kernel.name}(v, h, out):"]
    for function, targets in kernel.blocks:
        lines, results = _walk(function, kernel.reads, _PYTHON)
        text += [f"    {line.name} = {line.text}" for line in lines]
        text += [f"    {array}[{targets[k]}] = {results[k]}" for k in sorted(results)]
    return "\n".join([*text, *([] if kernel.blocks else ["    pass"]), "", ""])


def emit_numpy(function: ca.Function, name: str) -> str:
    """Return a function of one vector as NumPy code ``name(v)``: v and the result are sequences of
    numbers or equal arrays.
    """
    lines, results = _walk(function, range(function.numel_in(0)), _NUMPY)
    text = [f"def {name}(v):", *(f"    {line.name} = {line.text}" for line in lines)]
    return "\n".join([*text, f"    return [{', '.join(results[k] for k in sorted(results))}]", ""])
