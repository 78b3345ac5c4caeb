"""A job with an offset: positions, repeats, limits, and jobs with a place of their own."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.errors import LimitError, OptionError
from threadline.jobs.operations import Move
from threadline.jobs.shifted import parse_offset, shifted
from threadline.machine import load_machine
from threadline.proof.options import Options, describe, options_from
from threadline.proof.pipeline import open_job, plan_job

EXAMPLES = Path(__file__).parents[2] / "examples"
WINDER = load_machine("lathe-winder")
FILE = EXAMPLES / "cone-dome-cylinder.prg"
TEXT = "X=12.5 mm, A=-30 deg"
BY = np.array([np.radians(-30.0), 0.0125, 0.0])


def targets(options: Options) -> np.ndarray:
    job = open_job(FILE, WINDER, options)
    return np.array([job.start, *(one.target for one in job if isinstance(one, Move))])


def test_every_position_is_shifted_alike() -> None:
    """Sums of two doubles: exact to one rounding."""
    there = targets(Options(interpolation="linear", offset=TEXT))
    assert there == pytest.approx(targets(Options(interpolation="linear")) + BY, abs=1e-12)


def test_repeats_are_told_once_and_another_process_reads_the_same() -> None:
    job = open_job(FILE, WINDER, Options(offset=TEXT))
    plain = open_job(FILE, WINDER, Options())
    assert [(times, line) for _, times, line in job.folded()] == [
        (times, line) for _, times, line in plain.folded()
    ]
    again = pickle.loads(pickle.dumps(job.operations))
    assert [o.target for o in again if isinstance(o, Move)] == [
        o.target for o in job if isinstance(o, Move)
    ]


def test_the_rows_are_those_of_the_programs_own_place() -> None:
    """Whole counts of X and none of Y: the same increments, from another start."""
    away = f"X={100 / 55.358!r} mm"
    plans = [
        plan_job(open_job(EXAMPLES / "x-180.prg", WINDER, options), WINDER, options)
        for options in (Options(), Options(offset=away))
    ]
    starts = [plan.commands.start_counts for plan in plans]  # type: ignore[union-attr]
    assert (starts[1] - starts[0]).tolist() == [0, 100, 0]
    rows = [np.concatenate([b.counts for b in plan.commands]) for plan in plans]  # type: ignore[union-attr]
    assert np.abs(rows[0] - rows[1]).max() <= 1  # a place on the edge between two counts


def test_beyond_the_travel_is_refused() -> None:
    """x-180 goes to 180 mm; the travel ends at 500 mm."""
    options = Options(offset="X=321 mm")
    with pytest.raises(LimitError, match="travel"):
        plan_job(open_job(EXAMPLES / "x-180.prg", WINDER, options), WINDER, options)


def test_offset_is_recorded_with_the_plan() -> None:
    options = Options(offset=TEXT)
    job = open_job(FILE, WINDER, options)
    assert options_from(describe(job, WINDER, options)) == options
    assert "offset" not in describe(job, WINDER, Options())


@pytest.mark.parametrize("text", ["Q=1 mm", "X", "X=1", "X=1 deg", "X=1 mm; A=2 deg", ""])
def test_malformed_offset_is_refused(text: str) -> None:
    with pytest.raises(OptionError, match="offset"):
        parse_offset(text, WINDER)


def test_offset_is_refused_for_seams_and_mandrels_with_a_profile() -> None:
    stitcher = load_machine("stitcher")
    seam = open_job(EXAMPLES / "strap.seam.toml", stitcher, Options())
    with pytest.raises(OptionError, match="is no part program"):
        shifted(seam, stitcher, "X=1 mm")
    options = Options(offset="X=1 mm", radius="A=20 mm at X 0 mm; 50 mm at X 100 mm")
    with pytest.raises(OptionError, match="the mandrel has a radius for each place"):
        open_job(FILE, WINDER, options)
    assert open_job(FILE, WINDER, replace(options, offset=None)).start == (0.0, 0.0, 0.0)
