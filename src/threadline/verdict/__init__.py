"""Specification, measures and the judge of recordings."""

from threadline.verdict.each_run import CriterionRow, EachRun
from threadline.verdict.judge import Judge, judge, with_lines
from threadline.verdict.registry import needed_channels
from threadline.verdict.rendering import (
    closing,
    closing_of_all,
    criteria_json,
    happened_lines,
    happened_rows,
    in_a_word,
    of_moving_axes,
    percent_used,
    step_rows,
    verdict_json,
    verdict_rows,
)
from threadline.verdict.sewn import SewnStitches, sewn_stitches
from threadline.verdict.spec import is_assumed, load_spec
from threadline.verdict.tracking import as_intended
from threadline.verdict.types import Criterion, Result, Spec, Status, Verdict

__all__ = [
    "Criterion", "CriterionRow", "EachRun", "Judge", "Result", "SewnStitches", "Spec", "Status",
    "Verdict", "as_intended", "closing", "closing_of_all", "criteria_json", "happened_lines",
    "happened_rows", "in_a_word", "is_assumed", "judge", "load_spec", "needed_channels",
    "of_moving_axes", "percent_used", "sewn_stitches", "step_rows", "verdict_json", "verdict_rows",
    "with_lines",
]  # fmt: skip
