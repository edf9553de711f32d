"""Where a result comes from: version, date and platform of the run that made it."""

from __future__ import annotations

import platform
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any


def provenance() -> dict[str, Any]:
    """Return version of the library, date and time in UTC, and platform, for the key `provenance` of a result."""
    machine = f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"
    return {"version": version("bristle"), "date": datetime.now(UTC).isoformat(timespec="seconds"), "platform": machine}
