"""The distance of a motion from the programmed path, measured with few points."""

from __future__ import annotations

import pytest

from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.verdict import deviation


def plan_of(folder, text: str):
    job = folder / "job.gcode"
    job.write_text(text)
    machine = load_machine("stepper-winder")
    options = Options(interpolation="auto", radius="A=50 mm")
    return plan_job(open_job(job, machine, options), machine, options)


def test_few_points_measure_as_many_do(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The corners of a zigzag agree to a nanometre, with half of the points or fewer."""
    zigzag = "".join(f"G1 X{10 * k} A{40 * (k % 2)} F300\n" for k in range(1, 12))
    plan = plan_of(tmp_path, f"G21 G90\n{zigzag}M2\n")
    taken = []

    def counted(measures, block):
        taken.append(len(block.time_s))
        feed(measures, block)

    feed = deviation.feed
    monkeypatch.setattr(deviation, "feed", counted)
    (few,) = deviation.measure_motion_deviation(plan)
    count = sum(taken)
    monkeypatch.setattr(deviation, "CHORD_ERROR_M", 1e-18)
    taken.clear()
    (many,) = deviation.measure_motion_deviation(plan)
    assert 1e-5 < few.value == pytest.approx(many.value, abs=1e-9)
    assert few.operation == many.operation
    assert count < sum(taken) / 2
