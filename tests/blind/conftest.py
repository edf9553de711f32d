"""The blind test is a program, not a package: its folder goes on the path, and the one that it
shares.
"""

from __future__ import annotations

import sys
from pathlib import Path

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
sys.path[:0] = [str(BENCHMARKS / "blind"), str(BENCHMARKS)]
