"""The mandrel and the fibre on the page, compared with the helix of a program."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from threadline.errors import InputError
from threadline.files import Channel, ChannelKind, Clock, Recording, RecordingBlock, Stream
from threadline.machine import load_machine
from threadline.panel.calculating import calculate
from threadline.panel.calculation import Calculation, add_winding
from threadline.panel.job_views import tension_figures
from threadline.panel.protocol import Calculate, Figures

PITCH_M, TURNS = 0.004, 6
PROGRAM = (
    "%\nO 1;\nG91;\nG01 F 4000;\nN 10 Y 60 X 20;\n"
    f"N 20 A {360 * TURNS} X {1e3 * PITCH_M * TURNS};\nM30;\n%\n"
)
PRODUCT = (
    '[mandrel]\nat = "-20 mm"\n[[part]]\nkind = "cylinder"\nradius = "50 mm"\nlength = "120 mm"\n'
    '[band]\nwidth = "4 mm"\n[friction]\nvalue = "0.3"\n'
)


def _calculate(folder: Path, machine: str = "lathe-winder", **words: Any) -> dict[str, Any]:
    usual = {"program": "helix.prg", "interpolation": "linear", "level": "nominal"}
    asked = Calculate(what="calculate", **{**usual, **words})
    request = {**asked.model_dump(exclude={"what"}), "proof_file": str(folder / "proof.json")}
    return calculate(
        {**request, "folder": str(folder), "machine": machine, "par": None, "spec": None}
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("programs")
    (made / "helix.prg").write_text(PROGRAM)
    (made / "tube.wind.toml").write_text(PRODUCT)
    return made


@cache
def _found(folder: Path) -> dict[str, Any]:
    return _calculate(folder, product="tube.wind.toml")


def test_the_fibre_of_a_calculation_is_the_helix_of_its_program(folder: Path) -> None:
    """The product is a file of the folder; the helix has the pitch of the eye's motion."""
    wound = _found(folder)["wound"]
    json.dumps(wound, allow_nan=False)
    assert wound["mandrel"]["axis"] == "A" and wound["mandrel"]["along"] == "X"
    assert wound["mandrel"]["at"][0] == pytest.approx(-0.02)
    assert wound["mandrel"]["at"][-1] == pytest.approx(0.1)
    assert set(wound["mandrel"]["radius"]) == {0.05} == set(wound["radius"])
    assert wound["width"] == 0.004
    times_s, along, angle = (np.array(wound[name]) for name in ("times_s", "along", "angle"))
    assert (np.diff(times_s) > 0.0).all()
    # Two places are half a band of laid fibre apart; ticks of 5 ms add up to 1 mm.
    laid = np.hypot(np.diff(along), 0.05 * np.diff(angle))
    assert laid.min() > 0.5e-3 and laid.max() < 4e-3
    steady = slice(len(along) // 4, -len(along) // 8)
    pitch = 2.0 * math.pi * np.diff(along[steady]) / np.abs(np.diff(angle[steady]))
    np.testing.assert_allclose(np.median(pitch), PITCH_M, rtol=0.02)
    assert wound["begins"] == [True] + [False] * (len(along) - 1)
    assert not any(wound["slips"][1:])


def test_a_winding_is_judged_on_its_own_product(folder: Path) -> None:
    """A job that is a product file with layers needs no other product, as ``threadline prove``."""
    (folder / "wound.wind.toml").write_text(f'{PRODUCT}[[layer]]\nkind = "hoop"\n')
    found = _calculate(folder, program="wound.wind.toml", interpolation="auto")
    assert found["wound"]["mandrel"]["at"][-1] == pytest.approx(0.1)
    judged = {one["name"]: one["status"] for one in found["criteria"]}
    assert judged["slip_tendency"] == "passed" and "lifting" in judged


def test_the_tension_is_told_in_pieces_with_its_least_and_its_most() -> None:
    """Means over pieces of equal length, the last one shorter; None without such a channel."""
    clock = Clock("tick", Fraction(1, 200))
    pulled = Channel(name="tension", kind=ChannelKind.TENSION, unit="N", axis="", clock=clock)
    values = np.concatenate([np.full(9_000, 7.0), np.full(4_001, 8.0)])
    values[100] = 9.5
    blocks = [
        RecordingBlock(first_tick={"tick": at}, samples={"tension": part})
        for at, part in ((0, values[:5_000]), (5_000, values[5_000:]))
    ]
    recording = Recording(
        channels=(pulled,), blocks=Stream.of(blocks), job_sha256="", machine_sha256="",
        simulated=True,
    )  # fmt: skip
    found = tension_figures(recording)
    assert found is not None
    assert len(found["mean"]) == len(found["times_s"]) == 4_334  # three samples each
    assert found["times_s"][:2] == [0.0, 0.015] and found["mean"][-1] == 8.0
    assert found["mean"][33] == pytest.approx(7.0 + 2.5 / 3.0, abs=1e-6)
    assert (found["least"], found["most"]) == (7.0, 9.5)
    none = Channel(name="x", kind=ChannelKind.COMMANDED, unit="m", axis="X", clock=clock)
    assert tension_figures(replace(recording, channels=(none,), blocks=Stream.of(()))) is None


@pytest.mark.long(shown_by="test_the_tension_is_told_in_pieces_with_its_least_and_its_most")
def test_a_spool_gives_the_tension_of_the_simulated_run(folder: Path) -> None:
    """The torque of the brake at the radius of the spool, and its friction; None without a spool.

    0.43 N m at 60 mm are 7.2 N, and 10 % more behind rollers, bath and eye.
    """
    found = _calculate(folder, "lathe-winder+spool", product="tube.wind.toml")
    tension = Figures.model_validate({"type": "figures", **found}).tension
    assert tension is not None
    times_s, mean = np.array(tension.times_s), np.array(tension.mean)
    assert len(times_s) == len(mean) and (np.diff(times_s) > 0.0).all()
    assert times_s[0] >= 0.0 and times_s[-1] < found["duration_s"] + 1.0
    assert np.median(mean[mean > 1.0]) == pytest.approx(1.1 * 0.43 / 0.06, rel=0.05)
    assert tension.least <= mean.min() and mean.max() <= tension.most
    assert _found(folder)["tension"] is None


def test_a_product_outside_the_folder_is_not_read(folder: Path, tmp_path: Path) -> None:
    outside = tmp_path / "tube.wind.toml"
    outside.write_text(PRODUCT)
    for name in (str(outside), "../tube.wind.toml"):
        with pytest.raises(InputError, match="not in the project folder"):
            _calculate(folder, product=name)


def test_the_page_reads_what_is_laid_so_far(folder: Path) -> None:
    calculation = Calculation(load_machine("lathe-winder"), None, folder, folder)
    now_s: list[float | None] = [None]
    app = FastAPI()
    add_winding(app, calculation, lambda: now_s[0])
    client = TestClient(app)
    assert client.get("/api/wound").status_code == 404
    figures = calculation._taken(dict(_found(folder)), {"program": "helix.prg"})
    times_s = calculation.wound["times_s"] if calculation.wound else []
    whole = client.get("/api/wound").json()
    assert whole["proof"] == figures.proof and not whole["running"]
    assert (whole["first"], whole["next"], whole["count"]) == (0, len(times_s), len(times_s))
    assert whole["mandrel"]["axis"] == "A" and whole["width"] == 0.004

    shown: list[float] = []
    for now in (0.0, 0.4 * times_s[-1], 0.7 * times_s[-1], times_s[-1]):
        now_s[0] = now
        words = {"proof": figures.proof, "after": len(shown)}
        part = client.get("/api/wound", params=words).json()
        assert part["running"] and part["first"] == len(shown)
        assert all(len(values) == part["next"] - part["first"] for values in part["fibre"].values())
        shown += part["fibre"]["times_s"]
        assert not shown or shown[-1] <= now
        assert ("mandrel" in part) == (part["first"] == 0)
    assert shown == times_s
    # A page with the fibre of an older calculation begins anew.
    other = client.get("/api/wound", params={"proof": "0" * 64, "after": 5}).json()
    assert other["first"] == 0 and "mandrel" in other
    assert client.get("/api/wound", params={"after": -1}).status_code == 422
    calculation.forget()
    assert client.get("/api/wound").status_code == 404
