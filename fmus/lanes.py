"""The program behind an FMU of bristle, in lanes: several runs at once, with its digits."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from bristle.model.lanes import TIMING as TIMING
from bristle.model.lanes import Lanes as Lanes

_kept: dict[tuple[str, str | None, tuple[str, ...]], Lanes] = {}
_making = threading.Lock()


def lanes_of(what: str, variant: str | None = None, effects: Sequence[str] = ()) -> Lanes:
    """Return lanes of their own of a plant, observer or controller; compiled once a process, or
    taken from the cache.

    Parameters
    ----------
    what, effects
        As of `bristle.fmus.build.build`.
    variant : str, optional
        The law or method, which is compiled alone.

    Raises
    ------
    BristleError
        As of `build`.
    """
    from bristle.fmus.build import program_of

    key = what, variant, tuple(sorted(effects))
    with _making:  # one thread makes what all use
        if key not in _kept:
            _kept[key] = Lanes(
                program_of(*key), what="plant, observer and controller for many runs at a time"
            )
        return _kept[key].twin()
