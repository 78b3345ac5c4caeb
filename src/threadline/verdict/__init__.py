"""Specification, measures and the judge of recordings."""

from threadline.verdict.judge import judge
from threadline.verdict.present import verdict_json, verdict_rows
from threadline.verdict.spec import load_spec
from threadline.verdict.types import Criterion, Result, Spec, Status, Verdict

__all__ = [
    "Criterion",
    "Result",
    "Spec",
    "Status",
    "Verdict",
    "judge",
    "load_spec",
    "verdict_json",
    "verdict_rows",
]
