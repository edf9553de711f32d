"""Conformance of an FMU: each point is one small function in a registry, of the archive, the description or the behaviour."""

from bristle.fmus.conformance import archive, description  # noqa: F401  they fill the registry
from bristle.fmus.conformance.behaviour import BEHAVIOUR
from bristle.fmus.conformance.judgement import conformance, junit, to_tree
from bristle.fmus.conformance.registry import POINTS, Result, Severity, Verdict, static_conformance

__all__ = ["BEHAVIOUR", "POINTS", "Result", "Severity", "Verdict", "conformance", "junit", "static_conformance", "to_tree"]
