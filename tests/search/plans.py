"""The job that tests of the yield plan."""

from __future__ import annotations

from pathlib import Path

JOB = Path(__file__).parents[2] / "examples" / "x-180.prg"
