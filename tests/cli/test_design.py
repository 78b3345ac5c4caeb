"""``threadline design``: exit status, JSON, and files for the next steps."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

import threadline.cli.design as command
from tests.blank_pictures import blank_pictures
from threadline.cli.main import main
from threadline.errors import OptionError
from threadline.machine import load_machine
from threadline.proof.options import options_of
from threadline.proof.pipeline import Trials
from threadline.search.design import DesignResult, Requirements
from threadline.search.design import design as search
from threadline.search.design_evaluate import Effort, Evaluator
from threadline.verdict import load_spec

PLACE = Path(__file__).parents[2] / "examples" / "stitcher-place.spec.toml"
SEAM = """
[stitching]
stitch_length = "0.1 in"
needle_speed = "75 stitch/s"
motion = "discrete"

[[contour]]
unit = "in"
points = [[0, 0], [1, 0], [1, 0.8]]
"""
MACHINE = """
base = "stitcher"
name = "mine"

[design.parameters]
frame = "none"
current = "none"
friction = "none"
load = "none"

[design.parameters.belt]
factor = [{low}, {high}]

[design.settings]
crossover = ["6 Hz exact, assumed", "10 Hz exact, assumed"]
phase_margin = ["70 deg exact, assumed", "85 deg exact, assumed"]
acceleration = ["25.74 % exact, assumed", "25.74 % exact, assumed"]

[design.known]
thesis = "none"
"""
QUICK = Effort(sample_log2=5, settings_log2=3, proposals=16, rounds=2, trade_rounds=1, side=3)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a seam and a machine whose belts may change; the search is short."""
    (tmp_path / "corner.seam.toml").write_text(SEAM)
    (tmp_path / "mine.toml").write_text(MACHINE.format(low=1, high=20))
    (tmp_path / "stuck.toml").write_text(MACHINE.format(low=0.9, high=0.95))

    library = resources.files("threadline.machine") / "library" / "stitcher.spec.toml"
    (tmp_path / "spec.toml").write_text(library.read_text(encoding="utf-8"))

    def quick(
        file: Path, machine: Any, spec: Any, options: Any, requirements: Requirements, progress: Any
    ) -> DesignResult:
        return search(file, machine, spec, options, replace(requirements, effort=QUICK), progress)

    monkeypatch.setattr(command, "search_design", quick)
    return tmp_path


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    captured = capsys.readouterr()
    code = stopped.value.code
    return (0 if code is None else int(code)), captured.out, captured.err


@pytest.mark.long(shown_by="test_a_design_is_planned_and_judged_as_a_proof_is_asked_to")
def test_the_work_goes_on_with_what_was_found(
    capsys: pytest.CaptureFixture[str], files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The written files prove in spec by themselves; the original machine does not."""
    blank_pictures(monkeypatch)
    seam, out = str(files / "corner.seam.toml"), files / "out" / "found.toml"
    out.parent.mkdir()
    code, text, err = run(
        capsys, "design", seam, "-m", str(files / "mine.toml"), "-s", str(PLACE), "-o", str(out),
        "--json", "--report", str(files / "report"),
    )  # fmt: skip
    assert code == 0, err
    content = json.loads(text)
    found = content["found"]
    assert (found["passed"], found["level"], found["runs"] >= 20) == (True, "repeated", True)
    assert found["factors"]["belt"] > 1.0
    assert found["share_of_limit"] <= 1.0
    assert content["as_built"]["share_of_limit"] > 1.0
    machine = load_machine(out)
    assert machine.links["x_belt"].stiffness.si == found["numbers"]["links.x_belt.stiffness"]
    assert machine.controllers["x"].gain.si == found["numbers"]["controllers.x.gain"]  # type: ignore[union-attr]
    # Its tolerance stays the same share.
    stiffness = machine.links["y_belt"].stiffness
    assert stiffness.tolerance_si / stiffness.si == pytest.approx(0.2)
    spec = load_spec(None, machine)
    length = next(c for c in spec.criteria if c.name == "stitch_length_error")
    assert length.options["delay"] == pytest.approx(found["needle_delay_s"])
    assert length.limit == pytest.approx(0.05)
    # At the level of the redesign, the same as that of prove.
    again = shlex.split(content["command"])
    assert again == ["threadline", "prove", seam, "-m", str(out)]
    code, text, err = run(capsys, *again[1:], "--json")
    assert code == 0, err
    assert json.loads(text)["level"] == "repeated"
    assert run(capsys, "prove", seam, "-m", str(files / "mine.toml"), "--json")[0] == 1
    page = (files / "report" / "design.html").read_text()
    assert "links.x_belt.stiffness" in page


def test_none_within_the_bounds(capsys: pytest.CaptureFixture[str], files: Path) -> None:
    """If belts may only be softer, no design passes: exit status 1, the criterion, and no file."""
    seam, out = str(files / "corner.seam.toml"), files / "found.toml"
    code, text, _ = run(
        capsys, "design", seam, "-m", str(files / "stuck.toml"), "-s", str(PLACE), "-o", str(out)
    )
    assert code == 1
    assert "no change within the bounds is in spec" in text
    assert "stitch length error binds" in text or "contour error binds" in text
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("-m", "stitcher-rigid"), "[design]"),
        (("-m", "mine.toml", "-o", "mine.toml"), "would be overwritten"),
        (("-m", "mine.toml", "-o", "found.txt"), ".toml"),
        (("-m", "mine.toml", "--plot", "belt,mass"), "belt"),
        (("-m", "mine.toml", "--needle", "3 mm"), "needle"),
        (("-m", "mine.toml", "--feed-forward", "--smoothing", "3 kg"), "36 ms"),
        (("-m", "mine.toml", "--smoothing", "40 ms"), "--feed-forward"),
    ],
)
def test_wrong_input(
    capsys: pytest.CaptureFixture[str],
    files: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.chdir(files)
    code, out, err = run(capsys, "design", "corner.seam.toml", *arguments)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert words in err


def test_a_design_is_planned_and_judged_as_a_proof_is_asked_to(
    files: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Limits, a robust plan and other machines that must pass: typed back, they mean the same.

    The search itself is not tested here.
    """
    given: list[Any] = []

    def noted(*arguments: Any) -> DesignResult:
        given.append(arguments)
        raise OptionError("far enough")

    monkeypatch.setattr(command, "search_design", noted)
    job = (str(files / "corner.seam.toml"), "-m", str(files / "mine.toml"), "--limits", "80 %")
    ahead = ("--feed-forward", "--robust", "100 %", "--smoothing", "50 ms")
    more = ("--ends", "100 %", "--band", "10 %", "--nominal")
    assert run(capsys, "design", *job, *ahead, *more)[0] == 2
    ((_, _, _, options, requirements, _),) = given
    assert requirements.trials == Trials(ends=1.0, band=0.1)
    evaluator = SimpleNamespace(
        space=SimpleNamespace(ahead=True, smoothing_s=lambda _: requirements.smoothing_s[0]),
        _options=options,
    )
    assert Evaluator.options_at(cast("Evaluator", evaluator), 0) == options_of(
        limits="80 %", feed_forward=True, robust="100 %", smoothing="50 ms"
    )
    monkeypatch.undo()
    code, _, err = run(capsys, "design", *job, "--robust", "100 %")
    assert code == 2 and "needs feed-forward" in err
