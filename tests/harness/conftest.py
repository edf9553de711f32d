"""Shared by the tests of the harness: scenario files, and tiny FMUs of somebody else's make."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bristle.model.compiler import compile_shared

BASE = """
duration = "2 s"
step = "1 ms"

[plant]
law = "modified"

[plant.parameters]
J = "0.001 kg.m2"

[observer]
method = "bastin_gevers"

[[checks]]
quantity = "estimates.b.error_percent"
max_abs = 1e6
"""

# A plant v' = 6.5 u - 2 v, theta' = v by explicit Euler; FAULT is what happens in doStep.
TINY = r"""
#define _XOPEN_SOURCE 700
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#define E __attribute__((visibility("default")))
typedef struct { double v[8]; } M;
enum { U = 1, THETA = 2, V = 3, GAIN = 4 };
/* What is wrong is in the environment, since not all of it can wait for a parameter. */
static int is(const char *what) { const char *f = getenv("TINY_TROUBLE"); return f && !strcmp(f, what); }
static void at(const char *what) { while (is(what)) pause(); }
__attribute__((constructor)) static void loaded(void) { at("load"); }
static int misstep(double *v)
{
    if (is("flood")) for (;;) puts("a line without end");
    if (is("stop")) raise(SIGSTOP);
    if (is("orphan")) kill(getppid(), SIGKILL), sleep(600);
    if (is("daemon") && !fork()) setsid(), signal(SIGTERM, SIG_IGN), close(1), close(2), sleep(600), _exit(0);
    if (is("memory")) for (size_t n = 1; ; n++) { char *p = malloc(1 << 26); if (!p) return 3; memset(p, 1, 1 << 26); }
    if (is("nan")) *v = NAN;
    if (is("discard")) return 2;
    if (is("fatal")) return 4;
    if (is("forge") || is("pipe")) {
        char path[4096];
        snprintf(path, sizeof path, "%s/answer", getenv("TMPDIR"));
        if (is("pipe")) { snprintf(path, sizeof path, "mkfifo %s/answer", getenv("TMPDIR")); if (system(path)) return 3; }
        else { FILE *f = fopen(path, "w"); fputs("cos\nsystem\n(S'touch forged'\ntR.", f); fclose(f); }
        _exit(0);
    }
    at("step");
    return 0;
}
E const char *fmi2GetTypesPlatform(void) { return "default"; }
E const char *fmi2GetVersion(void) { return "2.0"; }
E void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, const void *c, int vis, int log)
{ (void)n; (void)t; (void)g; (void)r; (void)c; (void)vis; (void)log; at("instantiate");
  M *m = calloc(1, sizeof(M)); m->v[GAIN] = 6.5; return m; }
E void fmi2FreeInstance(void *m) { at("free"); free(m); }
E int fmi2SetReal(M *m, const unsigned *vr, size_t n, const double *x)
{ for (size_t i = 0; i < n; i++) m->v[vr[i]] = x[i]; return 0; }
E int fmi2GetReal(M *m, const unsigned *vr, size_t n, double *x)
{ for (size_t i = 0; i < n; i++) x[i] = m->v[vr[i]]; return 0; }
E int fmi2DoStep(M *m, double t, double h, int p)
{
    (void)p;
    const double v = m->v[V];
    m->v[V] += h * (m->v[GAIN] * m->v[U] - 2 * v);
    m->v[THETA] += h * v;
    if (t >= 0.5) { FAULT }
    return t >= 0.5 ? misstep(&m->v[V]) : 0;
}
"""
XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="tiny" guid="{{tiny}}">
<CoSimulation modelIdentifier="{identifier}"/>
<UnitDefinitions><Unit name="deg"><BaseUnit rad="1" factor="0.0174532925"/></Unit><Unit name="V"/>
<Unit name="m"><BaseUnit m="1"/></Unit></UnitDefinitions>
<ModelVariables>
<ScalarVariable name="u" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="theta" valueReference="2" causality="output"><Real {unit}/></ScalarVariable>
<ScalarVariable name="{v}" valueReference="3" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="gain" valueReference="4" causality="parameter" variability="fixed">
<Real start="6.5" min="0" max="10"/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="2"/><Unknown index="3"/></Outputs>
<InitialUnknowns><Unknown index="2"/><Unknown index="3"/></InitialUnknowns></ModelStructure>
</fmiModelDescription>
"""
FAULTS = {
    "none": "",
    "error": "return 3;",
    "abort": "abort();",
    "segfault": "*(volatile int *)0 = 1;",
    "exit": "exit(7);",
}


@pytest.fixture(scope="session")
def tiny_fmu(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return a maker of foreign plant FMUs: fault, and what is wrong with the description."""
    from fmpy import platform, sharedLibraryExtension
    from fmpy.fmi2 import FMU2Slave

    names = {name for name in dir(FMU2Slave) if name.startswith("fmi2") and "Callback" not in name}
    stubs = "".join(
        f"E int {n}(void) {{ return 0; }}\n"
        for n in sorted(names)
        if not re.search(rf"\b{n}\(", TINY)
    )

    def make(
        fault: str = "none",
        *,
        identifier: str = "tiny",
        unit: str = "",
        v: str = "v",
        binary: bool = True,
    ) -> Path:
        folder = tmp_path_factory.mktemp(f"tiny_{fault}")
        library = folder / "tiny.so"
        compile_shared({"tiny.c": TINY.replace("FAULT", FAULTS[fault]) + stubs}, library)
        path = folder / f"{fault}.fmu"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(
                "modelDescription.xml", XML.format(identifier=identifier, unit=unit, v=v)
            )
            if binary:
                archive.write(
                    library,
                    f"binaries/{platform}/{identifier.split('/')[-1]}{sharedLibraryExtension}",
                )
        return path

    return make


@pytest.fixture
def scenario_file(tmp_path: Path) -> Callable[..., Path]:
    """Return a maker of scenario files."""

    def make(text: str = BASE, name: str = "case") -> Path:
        path = tmp_path / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return make


@pytest.fixture
def base() -> str:
    """A small scenario that runs."""
    return BASE


@pytest.fixture
def no_leftovers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Temporary files go to a folder of their own, which must be empty at the end."""
    import tempfile

    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert os.listdir(folder) == []


@pytest.fixture
def rows_of() -> Callable[..., Any]:
    """Return a function that runs another importer in a process of its own: its module, code that
    fills `rows`, names it uses.
    """

    def run(importer: str, code: str, **names: object) -> Any:
        if find_spec(importer) is None:
            pytest.skip(f"{importer} is not installed (bristle[interop])")
        loaded = subprocess.run(
            [sys.executable, "-c", f"import {importer}"],
            capture_output=True,
            text=True,
            check=False,
        )
        if loaded.returncode:  # a library that it needs is not on this machine
            pytest.skip(f"{importer} cannot be loaded: {loaded.stderr.strip().splitlines()[-1]}")
        head = "".join(f"{name} = {value!r}\n" for name, value in names.items()) + "rows = []\n"
        tail = "\nimport json\nprint('ROWS', json.dumps(rows))\n"
        done = subprocess.run(
            [sys.executable, "-c", head + code + tail],
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        [answer] = [
            line for line in done.stdout.splitlines() if line.startswith("ROWS")
        ] or pytest.fail(done.stderr[-2000:])
        return np.array(json.loads(answer.removeprefix("ROWS ")))

    return run
