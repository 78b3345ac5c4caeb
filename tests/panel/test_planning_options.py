"""Planning options on the panel: the same as on the command line, with the same results."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from threadline.base.option_defaults import DEFAULT_CONTOUR_M, DEFAULT_TOLERANCE
from threadline.cli.main import main
from threadline.errors import OptionError
from threadline.machine import load_machine
from threadline.panel.calculating import calculate
from threadline.panel.protocol import Calculate
from threadline.proof.kinds import kind_of
from threadline.proof.option_form import Door
from threadline.proof.option_table import options_for
from threadline.proof.options import options_of

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
GIVEN: dict[str, Any] = {
    "interpolation": "optimal", "law": "cycloidal", "feed": "100 stitch/min", "radius": "A=40 mm",
    "offset": "X=12 mm", "tolerance": "0.05 mm", "contour": "0.45 mm", "limits": "90 %",
    "shaper": "zv:12Hz:0.02", "feed_forward": True, "smoothing": "50 ms", "robust": "100 %",
    "feed_mode": "path", "dialect": "grbl", "needle": "20 stitch/s", "axes": "A=X,X=A",
    "outside": "0.05 mm", "reserve": "5 %", "narrow": "1: 0.05 mm",
    "mode": "3 Hz", "damping": "0.1",
}  # fmt: skip
"""A text for each option; what some of them need is given with them."""
WITH = {
    "robust": {"feed_forward": True}, "smoothing": {"feed_forward": True},
    "contour": {"interpolation": "optimal"}, "outside": {"interpolation": "optimal"},
    "reserve": {"interpolation": "optimal"}, "narrow": {"interpolation": "optimal"},
    "mode": {"shaper": "zv"}, "damping": {"shaper": "zv"},
}  # fmt: skip


@pytest.mark.parametrize("machine", ["lathe-winder", "stitcher", "letter-placer", "schiffli-frame"])
@pytest.mark.parametrize("name", GIVEN)
def test_a_kind_of_work_takes_the_options_that_it_tells(machine: str, name: str) -> None:
    """Every other option is refused, and the page has no field for it."""
    here = load_machine(machine)
    kind, text = kind_of(here), GIVEN[name]
    if name == "feed" and machine != "schiffli-frame":
        text = "36 mm/s"
    defaults = {"interpolation": "auto", "feed": None, "tolerance": DEFAULT_TOLERANCE}
    beside = {} if (name, machine) == ("robust", "schiffli-frame") else WITH.get(name, {})
    options = options_of(**{**defaults, **beside, name: text})
    if name.replace("_", "-") in kind.planned_by:
        kind.check_options(here, options)
    else:
        with pytest.raises(OptionError):
            kind.check_options(here, options)


@pytest.mark.long(only="stitcher-stitcher-even.seam.toml-words0")
@pytest.mark.parametrize("machine, program, words", [
    ("stitcher", "stitcher-even.seam.toml", {"feed_forward": True, "robust": "0 %"}),
    ("schiffli-frame", "rosette.dst", {"law": "cycloidal", "tolerance": "0.5 mm"}),
    ("lathe-winder", "x-180.prg", {"interpolation": "optimal", "contour": "0.2 mm"}),
    ("letter-placer", "letter-cycle.toml", {"shaper": "um-zv", "mode": "3 Hz", "band": "10 %"}),
    ("lathe-winder", "x-180.prg", {"interpolation": "linear", "ends": "50 %"}),
])  # fmt: skip
def test_the_panel_proves_what_the_command_line_proves(
    machine: str, program: str, words: dict[str, Any], tmp_path: Path
) -> None:
    """To the bit: the hash of the proof covers job, machine, options, rows and every criterion."""
    written = [
        one
        for name, text in words.items()
        for one in (f"--{name.replace('_', '-')}", *([] if text is True else [text]))
    ]
    by_line, by_panel = tmp_path / "line.proof.json", tmp_path / "panel.proof.json"
    job = str(EXAMPLES / program)
    with pytest.raises(SystemExit) as ended:
        main(["prove", job, "-m", machine, *written, "--nominal", "--proof", str(by_line)])
    asked = Calculate(what="calculate", program=program, level="nominal", **words)
    found = calculate({
        **asked.model_dump(exclude={"what"}), "proof_file": str(by_panel),
        "folder": str(EXAMPLES), "machine": machine, "par": None, "spec": None,
    })  # fmt: skip
    assert by_panel.read_bytes() == by_line.read_bytes()
    assert found["proof"] == json.loads(by_line.read_text("utf-8"))["sha256"]
    assert found["passed"] == (ended.value.code == 0)
    if machine == "stitcher":
        assert found["passed"]  # as the example and docs/validation-stitcher.md have it


def test_the_page_tells_the_defaults_of_the_command_line() -> None:
    page = (ROOT / "web" / "index.html").read_text("utf-8")
    placeholders = dict(re.findall(r'id="([a-z-]+)" placeholder="([^"]*)"', page))
    assert placeholders["tolerance"] == DEFAULT_TOLERANCE
    assert placeholders["contour"] == f"{DEFAULT_CONTOUR_M * 1e3:g} mm, with optimal"
    fields = set(re.findall(r'data-option="([a-z-]+)"', page))
    names = re.findall(r' id="([^"]+)"', page)
    assert len(names) == len(set(names))
    labelled = {one.name for one in options_for("panel", Door.PANEL) if one.label}
    assert fields == labelled
    asked = Calculate(what="calculate", program="a.prg").model_dump()
    assert set(asked) == {"what", "program", "priority"} | {
        one.word for one in options_for("panel", Door.PANEL)
    }
