"""A dwell in the middle of a program, with every way of timing a motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job


@pytest.mark.parametrize(
    ("machine_name", "options"),
    [
        ("stitcher", Options(feed_forward_s=0.04)),
        ("lathe-winder", Options(interpolation="parabolic")),
        ("lathe-winder", Options(interpolation="cubic")),
        ("lathe-winder", Options(interpolation="quintic")),
        ("lathe-winder", Options()),
        ("lathe-winder", Options(interpolation="linear")),
    ],
)
def test_a_dwell_keeps_its_place_and_its_time(
    machine_name: str, options: Options, tmp_path: Path
) -> None:
    """Pieces follow each other without a gap or a jump; the axes stand for the whole of it."""
    file = tmp_path / "dwell.prg"
    file.write_text("%\nO1;\nG1 F600;\nG91;\nX20;\nG4 P0.7;\nX-5;\nM30;\n%\n")
    machine = load_machine(machine_name)
    trajectory = plan_job(read_job(file, machine), machine, options).motion.trajectory
    blocks = list(trajectory.blocks)
    starts = np.concatenate([b.start_s for b in blocks])
    ends = starts + np.concatenate([b.duration_s for b in blocks])
    np.testing.assert_allclose(starts[1:], ends[:-1], atol=1e-9)
    assert trajectory.duration_s == pytest.approx(ends[-1], abs=1e-9)

    times = np.arange(0.0, ends[-1], 1e-3)
    axis = list(trajectory.axes).index("X")
    inside = [times[(times >= b.start_s[0]) & (times < b.end_s)] for b in blocks]
    x = np.concatenate([b.evaluate(t) for b, t in zip(blocks, inside, strict=True)])[:, axis]
    standing = np.flatnonzero(np.abs(x - 0.02) < 1e-9)
    assert len(standing) * 1e-3 >= 0.7 - 2e-3  # sampled every millisecond
    assert standing[0] > 100 and standing[-1] < len(x) - 100
    assert np.abs(np.diff(x)).max() < 2e-4  # 10 mm/s, and no jump
