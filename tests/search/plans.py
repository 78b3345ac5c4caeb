"""The job for the tests of the yield."""

from __future__ import annotations

from pathlib import Path

JOB = Path(__file__).parents[2] / "examples" / "x-180.prg"
