# Sourced by the other scripts: makes .venv (or $BRISTLE_VENV) in the checkout and installs what is missing. $1: the extras wanted.
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root"

find_python() {
    for name in "${PYTHON:-python3}" python3.14 python3.13 python3.12 python3.11 python; do
        if command -v "$name" >/dev/null && "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            echo "$name"
            return
        fi
    done
    echo "bristle needs Python 3.11 or newer; install it, or set PYTHON to its path" >&2
    exit 2
}

has_compiler() {
    for name in ${CC:-} cc gcc clang; do command -v "$name" >/dev/null && return 0; done
    return 1
}

extras=$1
has_compiler || extras="${extras:+$extras,}cross"  # no C compiler on this machine: take zig from PyPI

venv="$root/${BRISTLE_VENV:-.venv}"
if ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then  # missing, or left half-made by an interruption
    rm -rf "$venv"
    python=$(find_python)
    if ! "$python" -m venv "$venv"; then
        rm -rf "$venv"
        echo "bristle: $python cannot make a virtual environment; install its venv module (Debian: python3-venv)" >&2
        exit 2
    fi
fi
stamp="$venv/installed-${extras:-core}"
if [ ! -e "$stamp" ] || [ pyproject.toml -nt "$stamp" ]; then
    echo "installing bristle${extras:+[$extras]} into ${venv#"$root/"}" >&2
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --upgrade "setuptools>=77" wheel
    # without compiling: Python compiles what it imports, a small part of it
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile --no-build-isolation -e ".${extras:+[$extras]}"
    touch "$stamp"
fi
export PATH="$venv/bin:$PATH"
