"""Animations: every frame shows the true place of the machine, in every format."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from PIL import Image

import threadline as tl
from tests.cli.test_commands import run
from tests.test_limits_alone import files as limits_alone
from threadline.proof.pipeline import Proof
from threadline.report import scenes
from threadline.report.animation import page_data, write_animation
from threadline.report.scenes import Scene, scene_of

EXAMPLES = Path(__file__).parents[2] / "examples"


def proof_of(job: str, machine: str, **words: str) -> Proof:
    return tl.prove(EXAMPLES / job, machine, level="nominal", **words).of  # type: ignore[arg-type,return-value]


@pytest.fixture(scope="module")
def winding() -> Proof:
    return proof_of(
        "helix.gcode", "lathe-winder", radius="A=50 mm", feed="200 mm/s", interpolation="linear"
    )


def in_world(scene: Scene, frame: int, sample: int) -> np.ndarray:
    """Return the place of a sample of the path in a frame, by the textbook's rotation matrix."""
    group = scene.groups[scene.group]
    turn = group.angle[frame]
    x, y, z = scene.actual[sample]
    turned = [x, y * np.cos(turn) - z * np.sin(turn), y * np.sin(turn) + z * np.cos(turn)]
    return np.array(turned) + group.shift[frame]


def test_the_fibre_is_laid_in_front_of_the_carriage(winding: Proof) -> None:
    """In each frame its last point is at the carriage's place, 50 mm in front of the axis."""
    scene = scene_of(winding)
    times, carriage = winding.recording.samples("X.load")
    for frame in range(scene.frames):
        at = in_world(scene, frame, frame * scene.per_frame)
        x_mm = 1e3 * np.interp(scene.time_s[frame], times, carriage)
        np.testing.assert_allclose(at, [x_mm, -50.0, 0.0], atol=1e-6)
        assert scene.groups["carriage"].shift[frame][0] == pytest.approx(x_mm)
    radii = np.hypot(scene.actual[:, 1], scene.actual[:, 2])
    np.testing.assert_allclose(radii, 50.0)
    worst_mm = 1e3 * (winding.verdict.result("contour_error").measured or 0.0)
    assert 0.5 * worst_mm < scene.error.max() <= 1.001 * worst_mm and scene.limit == 0.5


def test_the_needle_of_an_embroidery_machine_stands_still() -> None:
    scene = scene_of(proof_of("rosette.dst", "table-embroiderer"))
    for frame in range(0, scene.frames, 7):
        at = in_world(scene, frame, frame * scene.per_frame)
        np.testing.assert_allclose(at, 0.0, atol=1e-9)


def test_a_placer_swings_and_a_stitcher_goes_over_its_cloth() -> None:
    placer = scene_of(proof_of("letter-cycle.toml", "letter-placer"))
    assert placer.error_words == "swing of the frame" and "10 times" in placer.facts[1]
    sewn = proof_of("strap.seam.toml", "stitcher-rigid")
    seam = scene_of(sewn)
    at = np.column_stack([1e3 * np.interp(seam.time_s, *sewn.recording.samples(f"{a}.load"))
                          for a in "XY"])  # fmt: skip
    np.testing.assert_allclose(seam.groups["head"].shift[:, :2], at)


def test_limits_alone_are_shown_as_they_allow(tmp_path: Path) -> None:
    machine, job = limits_alone(tmp_path, "G1 X20 A90 F1000\nG1 X0")
    scene = scene_of(tl.prove(job, str(machine), level="nominal").of)  # type: ignore[arg-type]
    assert not len(scene.error) and scene.labels[1][0] == "as its limits allow"


def test_a_page_holds_all_that_it_draws(tmp_path: Path, winding: Proof) -> None:
    """No request to another computer, no text that ends the script, and whole numbers in it."""
    file = tmp_path / "a<b.html"
    scene = write_animation(winding, file)
    page = file.read_text()
    assert not re.search(r"https?:|//[a-z]|\bsrc=|\bhref=|@import|url\(", page)
    data = json.loads(re.search(r"const S = (.*);", page)[1])  # type: ignore[index]
    assert data == json.loads(json.dumps(page_data(scene)))
    assert len(data["time"]) * data["per"] == len(data["actual"]) == len(data["share"])


@pytest.mark.long(shown_by="test_a_page_holds_all_that_it_draws")
def test_a_gif_moves_and_is_read_without_colour(
    tmp_path: Path, winding: Proof, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a tenth of the frames; each is a picture of its own."""
    monkeypatch.setattr(scenes, "MOST_FRAMES", 24)
    file = tmp_path / "a.gif"
    scene = write_animation(winding, file)
    with Image.open(file) as film:
        assert film.n_frames == scene.frames
        grey = []
        for frame in (0, scene.frames // 2, scene.frames - 1):
            film.seek(frame)
            grey.append(np.asarray(film.convert("L"), dtype=float))
    assert all(np.abs(one - two).max() > 100 for one, two in pairwise(grey))


def test_unwritable_animation_is_refused_before_the_job_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before the job is read: the job's file does not even exist."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda _: False))
    for name, message in (("a.mp4", "there is no ffmpeg here"), ("a.avi", "is no animation")):
        status, _, err = run(capsys, "animate", "none.prg", "-m", "lathe-winder", "-o", name)
        assert status == 2 and message in err
    assert list(tmp_path.iterdir()) == []
