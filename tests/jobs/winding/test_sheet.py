"""The sheet of a winding tells masses, times, prices and the laminate, and refuses wrong data."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from threadline.cli.main import main
from threadline.errors import JobError
from threadline.jobs import own_product
from threadline.jobs.winding.build_up import Laid, design
from threadline.jobs.winding.layers import Winding, read_layers
from threadline.jobs.winding.sheet import sheet_of, sheet_warnings, wound_laminate
from threadline.machine import load_machine
from threadline.proof.options import options_of
from threadline.proof.pipeline import open_job, plan_job
from threadline.report.wound import layer_times, planned_sheet

MANDREL = """
[[part]]
kind = "hemisphere"
radius = "50 mm"
opening = "10 mm"
pole = "left"
[[part]]
kind = "cylinder"
radius = "50 mm"
length = "120 mm"
[[part]]
kind = "hemisphere"
radius = "50 mm"
opening = "10 mm"
pole = "right"
[friction]
value = "0.25 +- 0.05"
"""
BAND = """
[band]
width = "8 mm"
tex = 2400
material = "e-glass/epoxy"
fibre_volume = "60 %"
"""
LAYERS = """
[fibre]
speed = "200 mm/s"
tension = "15 N"
taper = "5 %"
[cost]
hour = "60 EUR/h"
[[layer]]
turn = "20 mm"
[[layer]]
kind = "hoop"
[[layer]]
turn = "30 mm"
tension = "9 N"
"""


def wound(folder: Path, text: str) -> tuple[Winding, tuple[Laid, ...]]:
    file = folder / "made.wind.toml"
    file.write_text(text, encoding="utf-8")
    winding = read_layers(file)
    return winding, design(winding)


def test_mass_time_and_cost_of_every_layer(tmp_path: Path) -> None:
    """By hand: tex times length; resin fills 40 % of the section; 2.5 and 8 EUR/kg; 60 EUR/h."""
    winding, laid = wound(tmp_path, MANDREL + BAND + LAYERS)
    sheet = sheet_of(winding, laid)
    for one, row in zip(laid, sheet.rows, strict=False):
        length = one.length_m + one.dwells_m
        assert row.fibre_m == length
        assert row.fibre_kg == pytest.approx(2.4e-3 * length, rel=1e-12)
        resin = 2.4e-3 / 2550.0 / 0.6 * 0.4 * 1170.0 * length
        assert row.resin_kg == pytest.approx(resin, rel=1e-12)
        assert row.time_s == pytest.approx(length / 0.2, rel=1e-12)
        cost = 2.5 * 2.4e-3 * length + 8.0 * resin + 60.0 * row.time_s / 3600.0
        assert row.cost == pytest.approx(cost, rel=1e-12)
        # The band's volume is fibre and resin: the layer's own volume is the same.
        band = one.layer.band
        assert band.thickness == pytest.approx(2.4e-3 / 2550.0 / 0.6 / 8e-3, rel=1e-12)
    assert [row.tension_n for row in sheet.rows[:3]] == pytest.approx([15.0, 14.25, 9.0])
    stress = 15.0 * 2550.0 / 2.4e-3
    assert sheet.rows[0].share == pytest.approx(stress / 2150e6, rel=1e-12)
    total = sheet.rows[-1]
    assert total.name == "all"
    assert total.cost == pytest.approx(sum(row.cost or 0.0 for row in sheet.rows[:-1]))
    assert sheet_warnings(winding, sheet) == []


def test_the_laminate_of_a_vessel_carries_its_pressure(tmp_path: Path) -> None:
    """Statics: sum of fibre stress, thickness and squared sine is p r round at the burst."""
    _, laid = wound(tmp_path, MANDREL + BAND + LAYERS)
    found = wound_laminate(laid)
    assert found is not None
    fibres = [(one.circuit.angle, 0.6 * (one.thickness_m or 0.0)) for one in laid]
    round_, along = (
        sum(2150e6 * t * f(angle) ** 2 for angle, t in fibres) for f in (math.sin, math.cos)
    )
    assert found.burst_pa * 0.05 == pytest.approx(min(round_, 2.0 * along), rel=1e-9)
    # All plies are balanced, so tension and shear do not couple.
    assert abs(found.laminate.a[0, 2]) < 1e-6 * found.laminate.a[0, 0]
    assert found.laminate.thickness == pytest.approx(sum(one.thickness_m or 0.0 for one in laid))


def test_a_layer_has_a_material_of_its_own(tmp_path: Path) -> None:
    own = """
    [[material]]
    name = "our-glass"
    like = "e-glass"
    price = "1.9 EUR/kg exact, printed: offer of May"
    """
    text = MANDREL + BAND + LAYERS.replace('"hoop"', '"hoop"\nmaterial = "our-glass/epoxy"') + own
    winding, laid = wound(tmp_path, text)
    plain, plain_laid = wound(tmp_path, MANDREL + BAND + LAYERS)
    mine, dear = sheet_of(winding, laid).rows[1], sheet_of(plain, plain_laid).rows[1]
    assert mine.material == "our-glass/epoxy"
    assert mine.cost is not None and dear.cost is not None and dear.fibre_kg is not None
    assert dear.cost - mine.cost == pytest.approx(0.6 * dear.fibre_kg, rel=1e-9)


def test_tension_above_a_share_of_the_strength_is_said(tmp_path: Path) -> None:
    """5 % of 2150 MPa on 2400 tex are 101 N."""
    text = MANDREL + BAND + LAYERS.replace("15 N", "120 N")
    winding, laid = wound(tmp_path, text)
    first, second = sheet_warnings(winding, sheet_of(winding, laid))
    limit = 0.05 * 2150e6 * 2.4e-3 / 2550.0
    assert f"Lower it to {limit:.3g} N" in first and "made.wind.toml:31" in first
    assert "114 N" in second


def test_without_a_material_the_sheet_says_what_it_knows(tmp_path: Path) -> None:
    text = MANDREL + '[band]\nwidth = "8 mm"\ntex = 2400\n[[layer]]\nturn = "20 mm"\n'
    winding, laid = wound(tmp_path, text)
    sheet = sheet_of(winding, laid)
    assert sheet.rows[0].fibre_kg == pytest.approx(2.4e-3 * sheet.rows[0].fibre_m)
    assert sheet.rows[0].resin_kg is None and sheet.rows[-1].cost is None
    assert sheet.currency == "" and wound_laminate(laid) is None
    assert sheet.table()[0][-1] == "-"


def test_thickness_and_tex_give_the_fibre_volume(tmp_path: Path) -> None:
    band = BAND.replace('fibre_volume = "60 %"', 'thickness = "0.2 mm"')
    _, laid = wound(tmp_path, MANDREL + band + LAYERS)
    volume = 2.4e-3 / 2550.0 / (8e-3 * 0.2e-3)
    assert laid[0].layer.band.fibre_volume == pytest.approx(volume, rel=1e-12)
    prepreg = '[band]\nwidth = "8 mm"\nthickness = "0.2 mm"\nmaterial = "t300-5208"\n'
    _, laid = wound(tmp_path, MANDREL + prepreg + LAYERS)
    assert laid[0].layer.band.tex == pytest.approx(1e6 * 0.7 * 8e-3 * 0.2e-3 * 1760.0, rel=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "expected_text", "line"),
    [
        ("e-glass/epoxy", "e-glas/epoxy", "there is no fibre 'e-glas'", 22),
        ("e-glass/epoxy", "e-glass/honey", "there is no resin 'honey'", 22),
        ("e-glass/epoxy", "t300", "there is no prepreg 't300'", 22),
        ("e-glass/epoxy", "t300-5208", "has a fibre volume of 70% already", 23),
        ('"60 %"', '"95 %"', "a fibre volume of 0.95: round fibres fill at most 91%", 23),
        ('"60 %"', '"60 %"\nthickness = "0.2 mm"', "say the same twice", 23),
        ('fibre_volume = "60 %"', 'thickness = "0.1 mm"', "leave a fibre volume of 1.18", 21),
        ('material = "e-glass/epoxy"\n', "", "a fibre_volume needs the material", 22),
        ('taper = "5 %"', 'taper = "150 %"', "taper is 1.5", 28),
        ('tension = "15 N"\n', "", "a taper needs the tension", 27),
        ('"9 N"', '"0 N"', "tension must be above 0", 37),
        ('"9 N"', '"9 kg"', "tension: ", 37),
        ("60 EUR/h", "60", "hour = '60' is no rate", 30),
        ("60 EUR/h", "60 USD/h", "prices in EUR and USD cannot be added", 30),
        (
            '[cost]\nhour = "60 EUR/h"', '[[material]]\nname = "m"\nlike = "e-glass"\nprice = '
            '"2 USD/kg exact, assumed"\n[[layer]]\nturn = "30 mm"\nmaterial = "m/epoxy"',
            "prices in EUR and USD", 32,
        ),
        (
            "[cost]", '[[material]]\nname = "m"\nlike = "epoxy"\nprice = "-3 EUR/kg exact, '
            'assumed"\n[cost]', "is not from 0 to 1e+06 per kg", 32,
        ),
        (
            "[cost]", '[[material]]\nname = "m"\nlike = "epoxy"\nmodulus = "1e18 Pa exact, '
            'assumed"\n[cost]', "must be at most 1e+15 Pa", 32,
        ),
        (
            "[cost]", '[[material]]\nname = "m"\nlike = "epoxy"\ndensity = "0 g/cm^3 exact, '
            'assumed"\n[cost]', 'Like density = "1.6 g/cm^3', 32,
        ),
        ("[cost]", '[[material]]\nname = "a/b"\nlike = "epoxy"\n[cost]', "and names have a-z", 30),
        ("[cost]", '[[material]]\nname = "m"\nkind = "metal"\n[cost]', "no kind 'metal'", 31),
        ("[cost]", '[[material]]\nname = "m"\n[cost]', "a material has no kind", 29),
        ("tex = 2400", "tex = -1", 'Write tex = "2400"', 21),
        ("hour =", "hours =", "unknown key 'hours'", 30),
        ("[cost]", '[[material]]\nname = "e-glass"\nlike = "t300"\n[cost]', "already", 30),
        ("[cost]", '[[material]]\nname = "mine"\nlike = "e-glas"\n[cost]', "no material 'e-g", 31),
        ("[cost]", '[[material]]\nname = "mine"\nkind = "resin"\n[cost]', "has no density", 29),
        ("[cost]", '[[material]]\nname = "m"\nlike = "epoxy"\nprice = "3"\n[cost]', "no price", 32),
        (
            "[cost]", '[[material]]\nname = "m"\nlike = "epoxy"\npoisson = "0.5 exact, assumed"\n'
            "[cost]", "a contraction of 0.5 must be below 0.5", 32,
        ),
    ],
)  # fmt: skip
def test_bad_materials_are_one_line(
    tmp_path: Path, old: str, new: str, expected_text: str, line: int
) -> None:
    text = MANDREL + BAND + LAYERS
    assert old in text
    with pytest.raises(JobError) as caught:
        winding, laid = wound(tmp_path, text.replace(old, new))
        sheet_of(winding, laid)
    message = str(caught.value)
    assert expected_text in message and "\n" not in message and caught.value.remedy
    assert caught.value.place is not None
    assert not line or caught.value.place.line == line


def run(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as caught:
        main(["wind", *map(str, words)])
    captured = capsys.readouterr()
    return caught.value.code, captured.out, captured.err


def test_wind_prints_the_sheet_and_writes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wound(tmp_path, MANDREL + BAND + LAYERS)
    file = tmp_path / "made.wind.toml"
    code, out, _ = run(capsys, file, "--report", tmp_path / "shop")
    assert code == 0
    assert "e-glass/epoxy" in out and "15 N (0.7%)" in out
    page = (tmp_path / "shop" / "sheet.html").read_text(encoding="utf-8")
    assert "e-glass/epoxy" in page and "Laminate at the largest radius" in page
    assert (tmp_path / "shop" / "sheet.pdf").read_bytes().startswith(b"%PDF")
    content = json.loads(run(capsys, file, "--json")[1])
    assert content["sheet"]["currency"] == "EUR"
    assert len(content["sheet"]["layers"]) == 3
    assert len(content["laminate"]["A"]) == 3 and content["laminate"]["burst_pa"] > 0.0


@pytest.mark.long(shown_by="test_mass_time_and_cost_of_every_layer")
def test_the_report_of_a_proof_has_the_times_of_its_plan(tmp_path: Path) -> None:
    """Two layers: the first with the approach, the second with the join, together the whole job."""
    layers = "".join(
        f'[[layer]]\nturn = "20 mm"\ncircuits = {count}\ncover = "1 %"\n' for count in (3, 5)
    )
    file = tmp_path / "short.wind.toml"
    file.write_text('[mandrel]\nat = "100 mm"\n' + MANDREL + BAND + layers, encoding="utf-8")
    machine = load_machine("lathe-winder")
    options = options_of(interpolation="linear", product=own_product(file))
    plan = plan_job(open_job(file, machine, options), machine, options)
    times = layer_times(plan, read_layers(file))
    assert times is not None and set(times) == {1, 2}
    assert sum(times.values()) == pytest.approx(plan.duration_s, abs=0.006)
    sheet, laminate = planned_sheet(plan)
    assert "Times of the plan" in sheet.note
    assert laminate.title == "Laminate at the largest radius"
    clocks = [row[-2] for row in sheet.rows]
    assert times[1] < times[2] and clocks[0] == f"{times[1]:.3g} s"
