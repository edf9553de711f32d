"""Output files: JSON content, a check that the folder is writable before a long computation, all
files or none.

Several files are put into their places by renaming them one after the other, which a killed process
leaves half done. A journal is written before the first is renamed, when all are complete: whoever
uses the folder next finishes what it says (`recover`).
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.errors import BristleError
from bristle.common.work import JOURNAL, OURS, lock, sweep, unlock, work_folder

PAGE = "report.html"
# file of numbers beside the page: command that writes both
PAGE_COMMANDS = {
    "result.json": "run",
    "diagnosis.json": "diagnose",
    "validation.json": "validate",
    "coupling.json": "coupling",
    "report.json": "report",
    "reproduce.json": "reproduce",
}
NEW, BEFORE = "new", "old"  # in a work folder: what is to come, and what was there


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it: arrays become lists, numbers that are not finite null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value


def to_json(content: Mapping[str, Any]) -> str:
    """Return the text of a JSON file."""
    return json.dumps(plain(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def complain(folder: Path, error: OSError) -> BristleError:
    """Return the error for a folder that cannot be written."""
    return BristleError(
        f"output folder {folder}: {error.strerror or error}; choose another folder or make room"
        " (nothing was changed)"
    )


def check_writable(out: Path) -> None:
    """Create the output folder and check that it is writable, before a long computation; finish
    what a killed process began.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        recover(out)
        with work_folder(out):
            pass
    except OSError as error:
        raise complain(out, error) from None


@contextmanager
def output_folder(out: Path, numbers: str = "") -> Iterator[None]:
    """Create the output folder and check that it is writable; if the work in the context fails,
    remove it if it is empty. `numbers` as of `check_page`, for a command that writes a page.
    """
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    try:
        check_writable(out)
        if numbers:
            check_page(out, numbers)
        yield
    except BaseException:
        for folder in made:
            with suppress(OSError):  # it is not empty
                folder.rmdir()
        raise


def write_file(path: Path, content: bytes) -> None:
    """Write a file through to the disk: a full disk may show only then."""
    with path.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def check_not_replaced(out: Path, names: Sequence[str], inputs: Iterable[Path]) -> None:
    """Raise `BristleError` if a file of these names in `out` would take the place of an input."""
    # unlike `resolve`, of a loop of links too
    places = {os.path.realpath(out / name) for name in names}
    for path in inputs:
        if os.path.realpath(path) in places:
            raise BristleError(
                f"{path}: would be replaced by what is written into {out}; give another folder"
            )


def check_page(out: Path, numbers: str) -> None:
    """Raise `BristleError` if a folder holds the page of another command than the one that writes
    `numbers`, a file of `PAGE_COMMANDS`, beside it.
    """
    others = [
        command
        for name, command in PAGE_COMMANDS.items()
        if name != numbers and (out / name).is_file()
    ]
    if others and (out / PAGE).is_file():
        raise BristleError(
            f"{out}: '{PAGE}' in it is of bristle {' and '.join(others)}; give another folder, such"
            f" as {out / PAGE_COMMANDS[numbers]}"
        )


def check_files_writable(files: Iterable[Path]) -> None:
    """Make the folders of files that are to be written later; raise `BristleError` if one of them
    could not be.

    So that a typo in a path is told before a long run and not after it.
    """
    for path in files:
        there = path.exists()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("ab"):
                pass
            if not there:
                path.unlink()
        except OSError as error:
            raise BristleError(
                f"{path}: {error.strerror or error}; give a file that can be written"
            ) from None


def check_no_folder(out: Path, names: Sequence[str]) -> None:
    """Raise `BristleError` if a file of one of these names could not be written into `out`, because
    a folder is called so.
    """
    for name in names:
        if (out / name).is_dir():
            raise BristleError(
                f"{out}: '{name}' in it is a folder, and a file of that name is to be written; move"
                " it away"
            )


def replace_files(out: Path, content: Mapping[str, bytes], names: Sequence[str]) -> list[Path]:
    """Put files into a folder in the place of older ones: all of them or none.

    Parameters
    ----------
    out : Path
        The folder, which exists.
    content : mapping of str to bytes
        The files by name, which may begin with a sub-folder.
    names : sequence of str
        All names that belong to the writer: files of these names that are not in `content` go.

    Returns
    -------
    list of Path
        The files that were written, in the order of `names`.

    Raises
    ------
    BristleError
        If the folder cannot be written or the disk is full; the folder is then as it was.
    """
    try:
        recover(out)
        with work_folder(out) as work:
            for folder in (work / NEW, work / BEFORE):
                folder.mkdir()
            for name, data in content.items():
                (work / NEW / name).parent.mkdir(parents=True, exist_ok=True)
                write_file(work / NEW / name, data)
            _switch(work, out, names)
    except OSError as error:
        raise complain(out, error) from None
    return [out / name for name in names if name in content]


def replace_file(path: Path, content: bytes) -> None:
    """Put one file in the place of an older one; raise `BristleError` as `replace_files`.

    What is no ordinary file, such as a pipe or ``/dev/stdout``, is written to.
    """
    if path.exists() and (not path.is_file() or path.is_relative_to("/dev")):
        try:
            with path.open("wb") as stream:
                stream.write(content)
        except OSError as error:
            raise BristleError(f"{path}: {error.strerror}; give another file") from None
    else:
        replace_files(path.parent, {path.name: content}, [path.name])


def replace_each(content: Mapping[Path, bytes]) -> None:
    """Put files in the place of older ones: those of a folder all or none; raise `BristleError` as
    `replace_file`.
    """
    folders: dict[Path, dict[str, bytes]] = {}
    for path, data in content.items():
        folders.setdefault(path.parent, {})[path.name] = data
    for folder, files in folders.items():
        if len(files) == 1 or any(
            (folder / name).exists() and not (folder / name).is_file() for name in files
        ):
            for name, data in files.items():
                replace_file(folder / name, data)
        else:
            replace_files(folder, files, list(files))


def recover(out: Path) -> None:
    """Finish what processes that were killed had begun to put into a folder, and sweep what else
    they left there.
    """
    found = [path for path in out.iterdir() if OURS.fullmatch(path.name)]
    if any((work / JOURNAL).exists() for work in found):
        with _alone(out):
            for work in (each for each in found if (each / JOURNAL).exists()):
                fresh, gone = _journal(work)
                _forward(work, out, fresh, gone)
                (work / JOURNAL).unlink()
                shutil.rmtree(work, ignore_errors=True)
    sweep(out)


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Keep other processes from putting files into a folder, where the system can lock one."""
    held = lock(out, wait=True)
    try:
        yield
    finally:
        unlock(held)


def _switch(work: Path, out: Path, names: Sequence[str]) -> None:
    """Put all that `work` has made into `out`, and remove the rest of these names there; or, if
    that fails, change nothing.
    """
    fresh = [name for name in names if (work / NEW / name).exists()]
    gone = [name for name in names if name not in fresh]
    if not gone and len(fresh) == 1 and not (work / NEW / fresh[0]).is_dir():
        (out / fresh[0]).parent.mkdir(parents=True, exist_ok=True)
        os.replace(work / NEW / fresh[0], out / fresh[0])  # one step as it is
        return
    with _alone(out):
        write_file(work / "draft", to_json({"new": fresh, "gone": gone}).encode())
        os.replace(work / "draft", work / JOURNAL)
        try:
            _forward(work, out, fresh, gone)
            (work / JOURNAL).unlink()
        except BaseException:
            _back(work, out, fresh, gone)
            (work / JOURNAL).unlink(missing_ok=True)
            raise


def _journal(work: Path) -> tuple[list[str], list[str]]:
    """Return the names of what is put into place and of what goes, all inside the folder."""
    path = work / JOURNAL
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        fresh, gone = ([Path(name) for name in content[key]] for key in ("new", "gone"))
    except (ValueError, TypeError, KeyError):
        fresh, gone = [], [Path("..")]
    if any(name.is_absolute() or ".." in name.parts for name in [*fresh, *gone]):
        raise BristleError(f"{path}: is no journal of bristle; remove the folder {work}")
    return [str(name) for name in fresh], [str(name) for name in gone]


def _forward(work: Path, out: Path, fresh: Sequence[str], gone: Sequence[str]) -> None:
    """Move what `out` has of these names into `work`, and what is fresh there into `out`; what is
    done already stays.
    """
    for name in (*fresh, *gone):
        if name in fresh and not (work / NEW / name).exists():
            continue
        if (out / name).exists():
            (work / BEFORE / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(out / name, work / BEFORE / name)
        if name in fresh:
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(work / NEW / name, out / name)


def _back(work: Path, out: Path, fresh: Sequence[str], gone: Sequence[str]) -> None:
    """Undo `_forward`, however far it came; each step leaves what `recover` can finish."""
    for name in (*fresh, *gone):
        if name in fresh and not (work / NEW / name).exists():
            os.replace(out / name, work / NEW / name)
        if (work / BEFORE / name).exists():
            os.replace(work / BEFORE / name, out / name)
