"""The commands, one file each; importing this package makes them known, in their order."""

from importlib import import_module

for _name in (
    "list_",
    "build",
    "run",
    "test_",
    "accept",
    "compare",
    "sweep",
    "query",
    "report",
    "export",
    "coupling",
    "reproduce",
    "schema",
    "new",
    "init",
    "diagnose",
    "validate",
    "stiction",
    "diff",
    "check",
):
    import_module(f"{__name__}.{_name}")

__all__: list[str] = []
