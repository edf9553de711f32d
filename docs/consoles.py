"""Run the commands of the tutorials: python docs/consoles.py [PAGE ...] rewrites the output below
each command.

A page has blocks of three kinds: `console` (lines that begin with "$ " are commands, the others
their output), and blocks with a title="FILE", which are written to that file before the commands
that follow. All commands of a page run in one shell and one folder.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TUTORIALS = Path(__file__).resolve().parent / "tutorials"
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
# what a long computation prints meanwhile
PROGRESS = re.compile(r"^(?:[\w ]+: .*, \d+%|bristle: compiling .*)\n", re.MULTILINE)
MARK = "--- end of output ---"
LIMIT = 900  # s


def commands(text: str) -> list[tuple[str, str]]:
    """Return every command of a page with the output that the page shows."""
    found: list[tuple[str, str]] = []
    for language, title, content in BLOCK.findall(text):
        if language == "console" and not title:
            for part in re.split(r"^\$ ", content, flags=re.MULTILINE)[1:]:
                command, _, output = part.partition("\n")
                found.append((command, output))
    return found


def script(text: str) -> str:
    """Return a shell script that writes the files of a page and runs its commands, with a mark
    after each output.
    """
    lines = []
    for language, title, content in BLOCK.findall(text):
        if title:
            lines.append(
                f"mkdir -p $(dirname {title}); cat > {title} <<'END_OF_FILE'\n{content}END_OF_FILE"
            )
        elif language == "console":
            for command in re.findall(r"^\$ (.*)$", content, re.MULTILINE):
                lines.append(f"{command}\n__code=$?; echo; echo '{MARK}'; (exit $__code)")
    return "\n".join(lines)


def outputs(text: str) -> list[str]:
    """Run the commands of a page in a folder of their own and return what each prints, both streams
    together, without progress.
    """
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scenarios").symlink_to(ROOT / "scenarios")
        paths = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        done = subprocess.run(
            ["bash", "-c", f"exec 2>&1\n{script(text)}"],
            cwd=folder,
            env=os.environ | {"PATH": paths, "COLUMNS": "120"},
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=False,
        )
    found = PROGRESS.sub("", done.stdout).split(f"\n{MARK}\n")
    return found[:-1]


def renewed(text: str) -> str:
    """Return a page with the outputs that its commands give now."""
    results = iter(outputs(text))

    def block(match: re.Match[str]) -> str:
        if match[1] != "console" or match[2]:
            return match[0]
        shown = re.findall(r"^\$ .*$", match[3], re.MULTILINE)
        body = "".join(f"{command}\n{next(results)}" for command in shown)
        return f"```console\n{body}```"

    return BLOCK.sub(block, text)


def main(names: list[str]) -> None:
    """Rewrite the pages that are named, or all."""
    for path in [TUTORIALS / name for name in names] or sorted(TUTORIALS.glob("*.md")):
        path.write_text(renewed(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
