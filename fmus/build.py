"""Build an FMU, or take it from the cache.

The symbolic code is imported only if something must be built, so that `obtain` is quick for an FMU
in the cache.
"""

from __future__ import annotations

import importlib
import json
import logging
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from bristle.common.cache import cached, digest
from bristle.common.errors import BristleError
from bristle.common.packages import code_offered, offered
from bristle.common.plugins import plugin_files
from bristle.model.compiler import FLAGS, compiler_identity

if TYPE_CHECKING:
    from bristle.model.program import Program
    from bristle.model.variables import Parameter

FMU_NAMES = ("plant", "observer", "controller")
# name of the option that chooses one variant
VARIANT_OPTION = {"plant": "law", "observer": "method"}
# kind of parts that these options choose from
VARIANT_KIND = {"plant": "laws", "observer": "observers"}
# s that a processor of 2022 takes to compile what all FMUs have, and an instruction of equations
SECONDS_OF_ANY, SECONDS_OF_INSTRUCTION = 1.0, 5e-4
HASHED_PACKAGES = (
    "bristle.common",
    "bristle.model",
    "bristle.plant",
    "bristle.observer",
    "bristle.fmus",
)
HASHED_DISTRIBUTIONS = ("bristle", "casadi", "fmpy", "pythonfmu")
# sub-folders of plug-in folders whose files an FMU may contain
HASHED_PLUGINS = ("laws", "effects", "observers")


def _check(
    what: str,
    fmi: int,
    kind: str,
    chosen: Mapping[str, str | None],
    effects: Sequence[str],
    platforms: str = "host",
) -> str | None:
    """Return the variant asked for, or None for all; raise `BristleError` if it cannot be built."""
    if what not in FMU_NAMES:
        raise BristleError(f"unknown FMU '{what}'; known: {', '.join(FMU_NAMES)}")
    if kind not in ("native", "python"):
        raise BristleError(f"unknown kind of FMU '{kind}'; known: native, python")
    if kind == "python" and platforms != "host":
        raise BristleError(
            "a python FMU has no binary of its own to compile; leave out the platforms, or choose"
            " native"
        )
    if fmi not in ((2, 3) if kind == "native" else (2,)):
        raise BristleError(
            f"a {kind} FMU cannot be of FMI {fmi}; choose {'2 or 3' if kind == 'native' else '2'}"
        )
    for name, value in chosen.items():
        if value is not None and VARIANT_OPTION.get(what) != name:
            raise BristleError(f"the {what} has no {name} to choose ('{value}'); leave it out")
    if isinstance(effects, str):
        raise BristleError(f"effects is the text '{effects}'; give a list of names: ['{effects}']")
    if effects and what != "plant":
        raise BristleError(f"the {what} has no effects to add ('{effects[0]}'); leave them out")
    return chosen["law" if what == "plant" else "method"]


def program_of(
    what: str, variant: str | None = None, effects: Sequence[str] = (), encoder: bool = True
) -> Program:
    """Return the program behind an FMU; effects and encoder as of `build`."""
    if what != "plant" and not encoder:
        raise BristleError(f"the {what} has no encoder; only the plant can be built without it")
    definition = importlib.import_module(f"bristle.fmus.{what}.definition")
    chosen = [] if variant is None else [variant]
    program: Program = (
        definition.program(variant, effects, encoder)
        if what == "plant"
        else definition.program(*chosen)
    )
    return program


def program_files(
    program: Program, fmi: int = 2, kind: str = "native", platforms: str = "host"
) -> dict[str, bytes]:
    """Return an FMU as file name -> bytes; `fmi`, `kind` and `platforms` as of `build`."""
    if kind == "python":
        from bristle.fmus.python_fmu import python_files

        return python_files(program)
    from bristle.fmus.native import native_files
    from bristle.fmus.platforms import find_platforms

    return native_files(program, fmi, find_platforms(platforms))


def build(
    what: str,
    out: Path,
    *,
    fmi: int = 2,
    kind: str = "native",
    law: str | None = None,
    method: str | None = None,
    effects: Sequence[str] = (),
    encoder: bool = True,
    parameters: Mapping[str, float] | None = None,
    units: Callable[[str, str], str] | None = None,
    platforms: str = "host",
    related: Callable[[Mapping[str, bytes]], Mapping[str, bytes]] | None = None,
) -> Path:
    """Write an FMU to a file.

    Parameters
    ----------
    what : {"plant", "observer", "controller"}
        Which FMU.
    out : Path
        The file.
    fmi : int
        2 or 3.
    kind : str
        ``native`` (C99, compiled) or ``python`` (for hosts that run in Python; FMI 2 only).
    law, method : str, optional
        One friction law or one observer alone, instead of all of them behind a parameter.
    effects : sequence of str
        Effects added to the plant: of one law, or of all laws that they can join.
    encoder : bool
        Whether the plant has its encoder outputs. Without them, the plant of one smooth law also
        offers Model Exchange.
    parameters : mapping of str to float, optional
        Start values of parameters in SI units, in place of their defaults.
    units : function, optional
        Gives the unit that a variable is declared with, from its name and its usual unit.
    platforms : str
        What a native FMU is compiled for: ``host``, ``all``, or names such as ``win64,linux64``
        (`find_platforms`).
    related : function, optional
        Gives files to add from the others; by default parameters, a smoke test and checksums
        (`related_files`).

    Raises
    ------
    BristleError
        If the FMU, law, method, effect or platform is unknown, there is no compiler, a parameter is
        unknown or out of range, or `out` cannot be written.
    """
    from bristle.fmus.pack import write_archive
    from bristle.fmus.related import related_files

    variant = _check(what, fmi, kind, {"law": law, "method": method}, effects, platforms)
    program = program_of(what, variant, effects, encoder).preset(parameters or {})
    declared = program if units is None else program.in_units(units)
    content = program_files(declared, fmi, kind, platforms)
    return write_archive(Path(out), {**content, **(related or related_files)(content)})


def _sources(package: str) -> list[str | bytes]:
    """Return names and contents of the files of a package, without the slow import."""
    spec = find_spec(package)
    assert spec is not None
    folder = Path(next(iter(spec.submodule_search_locations or ())))
    paths = sorted(
        path
        for path in folder.rglob("*")
        if path.suffix in (".py", ".c", ".h", ".txt", ".png", ".svg", ".html", ".csv")
    )
    return [
        part for path in paths for part in (path.relative_to(folder).as_posix(), path.read_bytes())
    ]


# Of the code that this process runs, so read at import: a later change of a file must not name an
# FMU of the code before it.
SOURCES = digest(*(part for name in HASHED_PACKAGES for part in _sources(name)))


def _key(packages: Sequence[str | bytes], kind: str, *arguments: object) -> str:
    """Return the hash of all that an FMU is made from; `packages`: the code of the installed
    packages among it.
    """
    plugins = [
        part
        for each in HASHED_PLUGINS
        for path in plugin_files(each, ".py")
        for part in (str(path), path.read_bytes())
    ]
    made_by = (*FLAGS, compiler_identity()) if kind == "native" else ()
    return digest(
        SOURCES,
        *plugins,
        *packages,
        *(version(name) for name in HASHED_DISTRIBUTIONS),
        *made_by,
        repr((kind, *arguments)),
    )


def _own_variants(what: str) -> Collection[str]:
    """Return the names of the laws or methods that the FMU of all has."""
    from bristle.observer import methods
    from bristle.plant.friction import laws

    return laws() if what == "plant" else methods()


def variant_names(what: str) -> list[str]:
    """Return the names of all laws or methods; those of installed packages are the last."""
    return list(dict.fromkeys([*_own_variants(what), *offered(VARIANT_KIND[what])]))


def is_packaged(what: str, variant: str) -> bool:
    """True if a law or method is of an installed package, and so in no FMU but one of it alone."""
    return variant in offered(VARIANT_KIND[what]) and variant not in _own_variants(what)


def plugins_of(what: str) -> bool:
    """True if plug-in folders have laws or methods."""
    return bool(plugin_files(VARIANT_KIND[what], ".py"))


def readers(what: str, name: str) -> dict[str, Parameter]:
    """Return the laws or methods, of those that the FMU of all has, that read a parameter, and how
    each declares it.
    """
    own, owner = _own_variants(what), name.partition(".")[0]
    # a name without an owner is read by all methods, or by several laws
    some = [owner] if owner in own else own if what == "plant" else []
    systems = [program_of(what, each).variants[0].system for each in some]
    return {each.name: each.parameters[name] for each in systems if name in each.parameters}


def compile_seconds(program: Program) -> float:
    """Return about how long it takes to compile a program: its functions as far as there are cores
    for them, no shorter than the longest of them, and what is the same in every FMU.
    """
    lengths = [
        sum(f.n_instructions() for kernel in each.kept().values() for f, _ in kernel.blocks)
        for each in program.variants
    ]
    work = max(max(lengths), sum(lengths) / (os.cpu_count() or 1))
    return SECONDS_OF_ANY + SECONDS_OF_INSTRUCTION * work


def nothing(_content: Mapping[str, bytes]) -> Mapping[str, bytes]:
    """Return no files to add: to an FMU that is run here and now, or gets them later."""
    return {}


def obtain(
    what: str,
    *,
    fmi: int = 2,
    kind: str = "native",
    law: str | None = None,
    method: str | None = None,
    effects: Sequence[str] = (),
    encoder: bool = True,
    parameters: Mapping[str, float] | None = None,
) -> Path:
    """Return an FMU as a file of the cache, built only if it is not there; without the files of
    `related_files`.

    Parameters
    ----------
    what, fmi, kind, law, method, effects, encoder, parameters
        As of `build`.

    Raises
    ------
    BristleError
        As of `build`.
    """
    variant = _check(what, fmi, kind, {"law": law, "method": method}, effects)
    parts = [("effects", effect) for effect in sorted(effects)]
    if variant:
        parts.append((VARIANT_KIND[what], variant))
    code = [text for part in parts for text in code_offered(*part)]
    values = sorted((parameters or {}).items())
    key = _key(code, kind, what, fmi, variant, encoder, *sorted(effects), *values)
    which = [what, *([variant] if variant else []), *sorted(effects)]
    name = "-".join([*which, f"fmi{fmi}", kind, key[:24]])

    def make(out: Path) -> None:
        from bristle.fmus.pack import write_archive

        program = program_of(what, variant, effects, encoder).preset(parameters or {})
        if kind == "native":
            message = "compiling an FMU (%s) once, about %.0f s; later runs take it from the cache"
            seconds = compile_seconds(program)
            logging.getLogger("bristle").info(message, ", ".join(which), seconds)
        write_archive(out, program_files(program, fmi, kind))

    return cached(f"{name}.fmu", make)


def estimated(method: str) -> list[str]:
    """Return the signals and parameters that an observer method estimates; its other outputs are
    always 0.

    They are kept as a file of the cache, so that only the first call makes the equations; an
    unknown method is a `BristleError`.
    """

    def make(out: Path) -> None:
        from bristle import observer

        out.write_text(json.dumps(observer.estimated(method)), encoding="utf-8")

    key = _key(code_offered(VARIANT_KIND["observer"], method), "estimated", method)
    found: list[str] = json.loads(
        cached(f"estimated-{method}-{key[:24]}.json", make).read_text(encoding="utf-8")
    )
    return found
