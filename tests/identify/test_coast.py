"""``threadline measure --experiment coast``: an axis without supply shows its friction."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import threadline as tl
from tests.identify.test_measure import STICKS, run
from threadline.errors import LimitError, OptionError, RecordingError
from threadline.files.formats import read_recording, write_recording
from threadline.identify.experiment_run import measure, predict
from threadline.identify.planned_experiment import experiment
from threadline.machine import load_machine

DAMPED = """base = "lathe-winder"
name = "damped"
[bodies.x]
damping = "0.002 N m s/rad exact, assumed"
"""
OFF = """base = "stitcher"
name = "off"
[bodies.x_head]
damping = "2331 N s/m +- 30 %, assumed"
"""
COAST = ("--axis", "X", "--experiment", "coast", "-o", "x.npz")


@pytest.fixture
def damped(tmp_path):
    """Return X of the winder with a damping, and nothing else that could stop it."""
    (tmp_path / "damped.toml").write_text(DAMPED)
    return load_machine(str(tmp_path / "damped.toml"))


@pytest.mark.usefixtures("forked_machine")
def test_coasting_axis_slows_by_damping_and_inertia_alone(damped):
    """v = v0 exp(-c t / J) from the cut on, within 1e-9: the motor neither drives nor brakes."""
    planned = experiment(damped, "X", "coast")
    recording = measure(damped, planned).recording
    rows = {
        name: np.concatenate([block.samples[name] for block in recording])
        for name in ("X.load", "supply_cut", "X.commanded")
    }
    begin = int(np.argmax(rows["supply_cut"])) + 1
    time = np.arange(len(rows["X.load"]) - begin) * 0.005
    left = np.exp(-0.002 / 3.606e-4 * time)
    load = rows["X.load"][begin:] - rows["X.load"][begin]
    speed = load[-1] / (1.0 - left[-1])
    assert speed > 0.1 * 3.606e-4 / 0.002
    assert np.abs(load - speed * (1.0 - left)).max() < 1e-9
    # Without the cut the axis would stop by its command as well.
    assert rows["X.commanded"][-1] == rows["X.commanded"][-20] > rows["X.load"][-1]


@pytest.mark.usefixtures("forked_machine")
def test_damping_that_is_30_percent_off_is_found(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "off.toml").write_text(OFF)
    code, out, _ = run(capsys, "measure", "off.toml", "--actual", "stitcher", *COAST)
    assert code == 0 and "coast of X in" in out
    words = ("fit", "x.npz", "-m", "off.toml", "--numbers", "bodies.x_head.damping", "--json")
    code, out, _ = run(capsys, *words)
    assert code == 0
    found = json.loads(out)["numbers"]["bodies.x_head.damping"]["value"]
    assert found == pytest.approx(3330.0, rel=0.03)


@pytest.mark.long(shown_by="test_damping_that_is_30_percent_off_is_found")
@pytest.mark.usefixtures("forked_machine")
def test_friction_is_found(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sticks.toml").write_text(STICKS)
    code, _, _ = run(capsys, "measure", "sticks.toml", "--actual", "lathe-winder+stiction", *COAST)
    assert code == 0
    words = ("fit", "x.npz", "-m", "sticks.toml", "--numbers", "bodies.x.friction", "--json")
    code, out, _ = run(capsys, *words)
    assert code == 0
    found = json.loads(out)["numbers"]["bodies.x.friction"]["value"]
    assert found == pytest.approx(0.05, rel=0.1)


def test_nothing_moves_where_nothing_would_stop_it():
    with pytest.raises(OptionError, match="not come to rest within 60 s without supply"):
        experiment(load_machine("lathe-winder"), "X", "coast")


def test_coast_ends_within_the_amplitude(damped):
    small, large = (experiment(damped, "X", "coast", amplitude=size) for size in (0.03, 0.1))
    for planned, size in ((small, 0.03), (large, 0.1)):
        foreseen = predict(damped, planned)
        assert 0.9 * size < foreseen.highest <= size
    assert small.cut_at_si < large.cut_at_si


def test_room_is_kept_for_twice_the_coast(damped):
    """The friction is unknown: the axis may coast farther than its file says."""
    axis = damped.axes["X"]
    low, high = axis.travel
    short = replace(axis, travel=(low, replace(high, si=0.12)))
    near = replace(damped, axes={**damped.axes, "X": short})
    planned = experiment(near, "X", "coast", amplitude=0.1)
    with pytest.raises(LimitError, match=r"the coast would reach a position of .* limit 0.12 m"):
        predict(near, planned)


def test_a_link_that_keeps_its_drives_on_is_refused(damped):
    with pytest.raises(OptionError, match="keeps the drives of a moving axis on"):
        measure(damped, experiment(damped, "X", "coast"), link="hal:plant")


@pytest.mark.usefixtures("forked_machine")
def test_a_coast_without_its_place_is_refused_by_the_fit(damped, tmp_path):
    recording = measure(damped, experiment(damped, "X", "coast")).recording
    kept = {key: text for key, text in recording.origin.items() if key != "cut_at_si"}
    write_recording(replace(recording, origin=kept), tmp_path / "x.npz")
    assert "supply_cut" in {one.name for one in read_recording(tmp_path / "x.npz").channels}
    with pytest.raises(RecordingError, match="the position at which the"):
        tl.fit(tmp_path / "x.npz", tmp_path / "damped.toml", ["bodies.x.damping"])
