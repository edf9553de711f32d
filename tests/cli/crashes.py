"""Runs commands, each in a fork of this process, which has imported everything, and kills it at one
of its changes of files.

A job is a line of JSON on the standard input: `arguments`, `cwd`, `env`, `point` (-1: it is not
killed) and `here` (in this process, which then knows the diagnosis and its files). The answer is a
line: `code` (negative: a signal), and `seen`, the number of changes.
"""

import ctypes
import json
import os
import sys
import tempfile


def command(arguments):
    from bristle.cli import main as cli

    sys.argv = ["bristle", *arguments]
    try:
        cli.main()
    except SystemExit as done:
        return done.code


def remembered(function):
    """Return a function that computes its first answer, and then gives that."""
    known = []
    return lambda *given: known[0] if known else known.append(function(*given)) or known[0]


def attempt(job, library):
    answer, said = os.pipe()
    child = os.fork()
    if not child:
        from bristle.common import work

        os.chdir(job["cwd"])
        os.environ.update(job["env"])
        tempfile.tempdir = None
        work._swept.clear()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        library.crash_arm(job["point"])
        code = command(job["arguments"])
        seen = library.crash_seen()
        library.crash_arm(-1)
        os.write(said, str(seen).encode())
        os._exit(code)
    os.close(said)
    seen = os.read(answer, 100).decode()
    os.close(answer)
    return {"code": os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), "seen": int(seen or -1)}


def main():
    import bristle.cli.commands.diagnose as diagnose
    from bristle.diagnosis.report import export
    from bristle.harness.run import figures

    library = ctypes.CDLL(os.environ.pop("LD_PRELOAD"))
    figures.draw = lambda pictures: {}  # takes longer than a short run
    diagnose._diagnosed, export._package = map(remembered, (diagnose._diagnosed, export._package))
    answers = os.fdopen(os.dup(1), "w")
    for line in sys.stdin:
        job = json.loads(line)
        if job["here"]:
            os.dup2(2, 1)
            os.chdir(job["cwd"])
            done = {"code": command(job["arguments"]), "seen": -1}
        else:
            done = attempt(job, library)
        print(json.dumps(done), file=answers, flush=True)


main()
