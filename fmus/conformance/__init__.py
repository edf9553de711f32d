"""Conformance of an FMU: each point is one small function in a registry, of the archive, the
description or the behaviour.
"""

from bristle.fmus.conformance import (  # noqa: F401 - they fill the registries
    archive,
    binary,
    calling,
    description,
    exchange,
    lives,
    states,
    stepping,
    values,
)
from bristle.fmus.conformance.judgement import conformance
from bristle.fmus.conformance.registry import (
    POINTS,
    PointResult,
    Severity,
    Verdict,
    static_conformance,
)
from bristle.fmus.conformance.report import junit, sarif, to_lines, to_tree
from bristle.fmus.conformance.running import BEHAVIOUR

__all__ = [
    "BEHAVIOUR",
    "POINTS",
    "PointResult",
    "Severity",
    "Verdict",
    "conformance",
    "junit",
    "sarif",
    "static_conformance",
    "to_lines",
    "to_tree",
]
