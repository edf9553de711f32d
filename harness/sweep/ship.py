"""A sweep on another machine: its FMUs packed, and written and read there once a process."""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from bristle.common.work import TemporaryFolder
from bristle.fmus.host import Alias, Fmu
from bristle.harness.sweep.spec import Sweep

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3  # parameters of mallopt, as malloc.h numbers them
# bytes of an array whose memory is kept: up to where the C library goes by itself
LARGEST_KEPT = 1 << 25


def packed(sweep: Sweep) -> Sweep:
    """Return a sweep with its files, for a machine that does not have them."""
    return replace(
        sweep, files={str(path): path.read_bytes() for path in {fmu.path for fmu in sweep.all_fmus}}
    )


def unpacked(sweep: Sweep) -> Sweep:
    """Return a sweep whose files are on this machine, written and read once a process."""
    if not sweep.files:
        return sweep
    with _unpacking:
        if sweep.name not in _unpacked_fmus:
            _keep_memory()
            places = _written(sweep.files)
            _unpacked_fmus[sweep.name] = {
                key: {name: _moved(fmu, places) for name, fmu in each.items()}
                for key, each in sweep.fmus.items()
            }
    return replace(sweep, fmus=_unpacked_fmus[sweep.name], files={})


_unpacking = threading.Lock()
# the FMUs of a sweep on this machine, by its name
_unpacked_fmus: dict[str, Mapping[str, dict[str, Fmu]]] = {}
_folders: list[TemporaryFolder] = []  # which live as long as the process


def _keep_memory() -> None:
    """Let the C library keep what a run frees for the next one, as it does by itself.

    Dask tells its workers to give memory back at once (MALLOC_TRIM_THRESHOLD_), so that each array
    of a run is mapped and cleared by the system: a chunk takes half as long again.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # of the GNU C library
    if mallopt is not None:
        mallopt(MMAP_THRESHOLD, LARGEST_KEPT)
        mallopt(TRIM_THRESHOLD, 2 * LARGEST_KEPT)


def _written(files: Mapping[str, bytes]) -> dict[str, Path]:
    _folders.append(TemporaryFolder("sweep"))
    paths = {}
    for place, (name, content) in enumerate(files.items()):
        paths[name] = Path(_folders[-1].name) / str(place) / Path(name).name
        paths[name].parent.mkdir()
        paths[name].write_bytes(content)
    return paths


def _moved(fmu: Fmu, places: Mapping[str, Path]) -> Fmu:
    aliases: dict[str, Alias] = fmu.aliases
    return Fmu(places[str(fmu.path)], fmu.foreign, aliases)
