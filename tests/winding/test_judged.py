"""The fibre of whole jobs: a program that passes, and faults that fail at their lines."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.winding import programs
from threadline.base.arrays import FloatArray
from threadline.cli.compare import comparison_tables
from threadline.cli.main import main
from threadline.commands.plan import Plan
from threadline.errors import OptionError
from threadline.machine import Machine, load_machine
from threadline.proof.option_form import Door
from threadline.proof.options import describe, options_from, options_of
from threadline.proof.pipeline import (
    NOMINAL,
    open_job,
    plan_job,
    prove_plan,
    with_product,
    with_shaping,
)
from threadline.proof.request import Words
from threadline.report.proof import write_report
from threadline.report.solid import wound_glb
from threadline.search.compare import compare, placement_spec
from threadline.search.question import question_of
from threadline.search.report_data import ReportData
from threadline.verdict import Spec, load_spec
from threadline.verdict.fibre import (
    MEASURED,
    PLANNED,
    measure_planned,
)
from threadline.verdict.finding import Finding
from threadline.verdict.laid_error import off_design
from threadline.verdict.pattern import CoverageGap, PatternClosure
from threadline.verdict.replayed import (
    Wound,
    WoundJob,
    product_at_random,
    programmed_fibre,
    wound_job,
)
from threadline.winding.clearance import Clearance
from threadline.winding.product import Product, product_of_text, product_text
from threadline.winding.product_reader import Toleranced
from threadline.winding.raster import Gap, Raster
from threadline.winding.replay import Replay

EXAMPLES = Path(__file__).parents[2] / "examples"
VESSEL, WAIST = EXAMPLES / "vessel.wind.toml", EXAMPLES / "vessel-waist.wind.toml"
FIRST_LINE = 3
"""Line of the first block of a circuit."""


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("lathe-winder")


@pytest.fixture(scope="module")
def vessel() -> Product:
    return product_of_text(product_text(VESSEL))


@pytest.fixture(scope="module")
def circuit(vessel: Product) -> FloatArray:
    """Return the eye of a circuit."""
    return programs.eyes(vessel.surface, programs.geodesic(vessel.surface)[1])


def _plan(folder: Path, machine: Machine, text: str, product: Path = VESSEL) -> Plan:
    file = folder / "p.prg"
    file.write_text(text)
    options = options_of(product=str(product))
    return plan_job(open_job(file, machine, options), machine, options)


def _found(plan: Plan) -> dict[str, Finding]:
    return {name: finding for name, (finding,) in measure_planned(plan).items()}


def _line(plan: Plan, finding: Finding) -> int:
    assert finding.operation is not None
    return plan.intent.lines_of(plan.job, [finding.operation])[finding.operation]


def test_the_examples_are_what_the_tests_write(circuit: FloatArray) -> None:
    circuits = programs.CIRCUITS
    for name, text in {
        "vessel": programs.program(circuit, circuits),
        "vessel-gap": programs.program(circuit, programs.TOO_FEW),
        "vessel-circuit": programs.program(circuit, 1, pieces=programs.PIECES),
        "vessel-slips": programs.program(circuit, circuits - 1, programs.slipping(circuit)),
        "vessel-lifts": programs.program(circuit, circuits - 1, programs.lifting(circuit)),
    }.items():
        assert (EXAMPLES / f"{name}.prg").read_text() == text


def test_a_geodesic_program_slips_nowhere(
    tmp_path: Path, machine: Machine, circuit: FloatArray
) -> None:
    """It is planned on the programmed chords: only rounding steers, no bridge and no lifting."""
    found = _found(_plan(tmp_path, machine, programs.program(circuit, 2)))
    assert found["planned_slip_tendency"].value == pytest.approx(0.0, abs=0.03)
    assert found["planned_bridging"].value == 0.0
    assert found["planned_lifting"].value == 0.0
    assert "after 2 circuits" in found["planned_pattern_closure"].note


def test_a_slip_is_found_at_its_line(tmp_path: Path, machine: Machine, circuit: FloatArray) -> None:
    text = programs.program(circuit, 1, programs.slipping(circuit))
    plan = _plan(tmp_path, machine, text)
    finding = _found(plan)["planned_slip_tendency"]
    assert finding.value is not None and finding.value > 0.25
    faulty = text.splitlines().index(f"M98 P 999 L {1};") + 2 + programs.FAULTY
    assert abs(_line(plan, finding) - faulty) <= 1


def test_lifting_is_found_at_its_line(
    tmp_path: Path, machine: Machine, circuit: FloatArray
) -> None:
    text = programs.program(circuit, 1, programs.lifting(circuit))
    plan = _plan(tmp_path, machine, text)
    finding = _found(plan)["planned_lifting"]
    assert finding.value is not None and finding.value > 1e-3
    faulty = text.splitlines().index("M98 P 999 L 1;") + 2 + programs.FAULTY
    # At its begin: most is unwound in the next block, as the planner rounds the corner.
    assert _line(plan, finding) == faulty


def test_a_waist_is_bridged(tmp_path: Path, machine: Machine, circuit: FloatArray) -> None:
    """The program of the smooth vessel, on a vessel with a waist of 5 mm in its cylinder."""
    plan = _plan(tmp_path, machine, programs.program(circuit, 1), WAIST)
    finding = _found(plan)["planned_bridging"]
    # Less than the depth of the waist: for a while the fibre lies on the cone before it.
    assert finding.value is not None and 5e-4 < finding.value < 5e-3
    block = _line(plan, finding) - FIRST_LINE
    # The place where the smooth vessel's fibre enters the waist: between its two rims.
    smooth = product_of_text(product_text(VESSEL)).surface
    path = programs.geodesic(smooth)[1]
    dome = (smooth.at(np.array([smooth.length_m]))[0][0, 0] - 0.09605) / 2.0
    along = smooth.at(path[block : block + 1, 0])[0][0, 0] - dome
    assert 0.03 < along < 0.03 + 2 * 0.018025


def _eyes(circuit: FloatArray, circuits: int) -> FloatArray:
    """Return (n, 6) eyes of equal circuits, from the mandrel's left end."""
    turn = circuit[-1, 0] - circuit[0, 0]
    rows = [circuit[1:] + np.array([k * turn, 0.0, 0.0]) for k in range(circuits)]
    eyes = np.zeros((1 + circuits * (len(circuit) - 1), 6))
    eyes[:, :3] = np.vstack([circuit[:1], *rows])
    eyes[:, 1] -= programs.AT_M
    return eyes


def _gap(vessel: Product, machine: Machine, circuit: FloatArray, circuits: int) -> Gap:
    eyes = _eyes(circuit, circuits)
    assert machine.tool is not None and vessel.covered is not None
    fibre = Replay(vessel.surface, machine.tool, 0.2, vessel.tied).feed(eyes)
    raster = Raster(vessel.surface, vessel.width.si, *vessel.covered)
    raster.lay(fibre.u, fibre.angle, fibre.winding, fibre.known, np.arange(len(fibre)))
    return raster.gap()


def test_the_pattern_closes_and_missing_circuits_leave_a_gap(
    vessel: Product, machine: Machine, circuit: FloatArray
) -> None:
    assert _gap(vessel, machine, circuit, programs.CIRCUITS).width_m == 0.0
    # It is bare only where a missing band of one direction crosses one of the other.
    missing = _gap(vessel, machine, circuit, programs.TOO_FEW)
    assert 2e-3 < missing.width_m < 8e-3
    assert 0.0 < missing.share < 0.03
    # The band beside it is within a width of the gap along the mandrel.
    path = programs.geodesic(vessel.surface)[1]
    beside = vessel.surface.at(path[missing.operation % (len(path) - 1), None, 0])[0][0, 0]
    place = float(missing.words.split("at ")[1].split(" mm")[0])
    assert abs(1e3 * beside - place) < 2e3 * vessel.width.si


@pytest.mark.long(shown_by="test_every_verb_that_judges_takes_the_fibre")
def test_a_run_is_judged_like_its_plan(
    tmp_path: Path, machine: Machine, circuit: FloatArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One circuit on the simulated machine: every measure has a value, the product is recorded."""
    plan = _plan(tmp_path, machine, programs.program(circuit, 1))
    options = options_from(describe(plan.job, machine, options_of(product=str(VESSEL))))
    assert options.product == plan.options["product"]
    spec = with_shaping(load_spec(None, machine), machine, options)
    proof = prove_plan(plan, spec, None, NOMINAL)
    results = {result.name: result for result in proof.verdict.results}
    assert {*MEASURED, *PLANNED} <= set(results)
    for name in ("slip_tendency", "lifting", "bridging", "free_length", "laid_error", "slack"):
        assert results[name].measured is not None, name
    slip, laid = results["slip_tendency"].measured, results["laid_error"].measured
    assert slip is not None and slip < 0.2
    # The controller is within 0.5 mm of its program, and so is the fibre on the mandrel.
    assert laid is not None and laid < 5e-4
    assert results["free_length"].measured == pytest.approx(programs.FREE_M, rel=0.03)
    assert not proof.verdict.passed  # one circuit leaves gaps
    monkeypatch.setattr("threadline.report.traces.MAX_SAMPLES", 5000)
    page = write_report(ReportData(proof=proof), tmp_path / "report")
    names = {file.name for file in page.parent.iterdir()}
    assert {"report-winding-map.svg", "report-winding-along.svg", "report-winding-map.glb"} <= names
    # The page names the product and does not quote it.
    text = page.read_text()
    assert "vessel.wind.toml, sha256" in text and "isotensoid" not in text
    # Every sample is drawn on the mandrel, although curves over time are thinned.
    assert "samples those at an extreme" in text
    assert "samples those" not in text.split("The unrolled mandrel: the darker")[1][:500]


def test_a_machine_without_an_eye_takes_no_product(tmp_path: Path) -> None:
    stitcher = load_machine("stitcher")
    options = options_of(product=str(VESSEL))
    file = tmp_path / "p.nc"
    file.write_text("G21\nG90\nG1 X10 F600\nM2\n")
    with pytest.raises(OptionError, match="--product needs the eye of a winder"):
        plan_job(open_job(file, stitcher, options), stitcher, options)


def test_every_verb_that_judges_takes_the_fibre(
    tmp_path: Path, machine: Machine, circuit: FloatArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program with a fault in its fibre alone is out of spec for ``compare`` and ``yield``."""
    file = tmp_path / "p.prg"
    file.write_text(programs.program(circuit, 1, programs.slipping(circuit)))
    options = options_of(product=str(VESSEL), interpolation="linear")
    job = open_job(file, machine, options)
    found = compare(job, machine, load_spec(None, machine), [options], with_fastest=False)
    failed = {r.name for r in found.proofs[0].verdict.results if r.status == "failed"}
    assert "slip_tendency" in failed and "contour_error" not in failed
    ((_, header, (row,)),) = comparison_tables(found)
    assert header[3:-1] == ["contour mm", "turning point mm", "slip %", "fibre off mm", "gap mm"]
    assert float(row[header.index("slip %")]) > 20.0
    words = Words.of("fastest", Door.LINE, {"product": str(VESSEL), "margin": "10 %"})
    asked = {one.name: one.limit for one in question_of(words, file, machine).spec.criteria}
    assert asked["slip_tendency"] == pytest.approx(0.9 * 0.2)
    searched = placement_spec(with_product(load_spec(None, machine), machine, options))
    assert {one.name for one in searched.criteria if one.limit} >= {"slip_tendency", "lifting"}
    # The search for its worst machine takes minutes: only its specification is read.
    given: list[set[str]] = []

    def taken(plan: Plan, spec: Spec) -> None:
        given.append({one.name for one in spec.criteria})
        raise OptionError("far enough", remedy="Go on.")

    monkeypatch.setattr("threadline.search.machine_yield.MachineYield", taken)
    with pytest.raises(SystemExit):
        main(["yield", str(file), "-m", "lathe-winder", "--product", str(VESSEL)])
    assert given[0] >= {"slip_tendency", "planned_lifting"}


def test_compile_says_why_it_takes_no_product(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["compile", "p.prg", "-m", "lathe-winder", "--product", "p.wind.toml"])
    assert ended.value.code == 2
    assert (
        "compile takes no --product: a product is for the judgement of the fibre, and no command "
        "depends on it. Give it to prove."
    ) in capsys.readouterr().err


def test_the_distance_of_the_eye_is_that_of_a_cylinder(tmp_path: Path) -> None:
    """An eye moves beside, inside and beyond a cylinder, whose distance is a closed form."""
    file = tmp_path / "c.wind.toml"
    file.write_text(
        '[[part]]\nkind = "cylinder"\nradius = "50 mm"\nlength = "200 mm"\n'
        '[band]\nwidth = "5 mm"\n[friction]\nvalue = "0.3"\n[fibre]\nclearance = "3 mm"\n'
    )
    product = product_of_text(product_text(file))
    tool = load_machine("lathe-winder").tool
    assert tool is not None
    chance = np.random.default_rng(1)
    eyes = np.zeros((20_000, 6))
    eyes[:, 1] = 0.1 + np.cumsum(chance.normal(0.0, 1e-3, 20_000))
    eyes[:, 2] = 0.055 + 0.01 * np.sin(np.arange(20_000) / 300.0)
    x, out = eyes[:, 1], eyes[:, 2] - 0.05
    beyond = np.maximum(np.maximum(-x, x - 0.2), 0.0)
    distance = np.where(beyond > 0.0, np.hypot(beyond, np.maximum(out, 0.0)), out)
    # Below its rim an end is nearer than the side.
    inside = (out < 0.0) & (beyond == 0.0)
    distance = np.where(inside, np.maximum(out, -np.minimum(x, 0.2 - x)), distance)
    expected = np.maximum(0.003 - distance, 0.0)
    assert (expected > 0.0).mean() > 0.1
    near = Clearance(product.surface, (), tool, 0.003)
    found = np.concatenate([near.feed(part) for part in np.array_split(eyes, 9)])
    # Every sample is as far as stated, or no nearer than an earlier one.
    is_nearest = found > 0.0
    np.testing.assert_allclose(found[is_nearest], expected[is_nearest], atol=1e-6)
    before = np.maximum.accumulate(expected)
    assert (expected[~is_nearest] <= before[~is_nearest] + 1e-6).all()
    assert found.max() == pytest.approx(expected.max(), abs=1e-6)
    assert near.words(0).startswith("the eye and the mandrel: it would fit with a radius")


@pytest.mark.parametrize("circuits", [programs.CIRCUITS, programs.TOO_FEW, 3])
def test_a_pattern_closes_after_its_number_of_circuits(
    vessel: Product, machine: Machine, circuit: FloatArray, circuits: int
) -> None:
    """A circuit is 63/44 of a turn by number theory, and the fibre's angle is Clairaut's."""
    assert machine.tool is not None
    eyes = _eyes(circuit, circuits)
    job = WoundJob(vessel, machine.tool, machine.axis_names)
    closing = PatternClosure([job], 3)
    replay = job.replay()
    for part in np.array_split(eyes, 7):
        fibre = replay.feed(part)
        blank = np.zeros((len(part), 3))
        closing.take([Wound(blank[:, 0], None, blank, fibre, part)])
    away = closing.found().worst()
    share = circuits * programs.TURNS / programs.CIRCUITS % 1.0
    share = min(share, 1.0 - share)
    cos = math.sqrt(1.0 - (programs.TURN_M / 0.05) ** 2)
    assert away.value == pytest.approx(share * 2.0 * math.pi * 0.05 * cos, abs=3e-4)
    assert f"after {circuits} circuits" in away.note


def test_the_design_is_found_again_where_the_fibre_was_not_known() -> None:
    """A helix of four turns is laid 0.1 mm beside in one part, and it or its design has a gap."""
    angle = np.linspace(0.0, 8.0 * np.pi, 4001)
    length = angle * math.hypot(0.02, 0.05)
    helix = np.column_stack([0.02 * angle, 0.05 * np.cos(angle), 0.05 * np.sin(angle), length])
    design, points = helix.copy(), helix.copy()
    design[1500:2500, :3] = np.nan
    points[800:1200, :3] = np.nan  # more than the stretch that is searched from place to place
    points[3000:, 0] += 1e-4
    points[:, 3] += 0.04  # it laid more before its place was known
    found = off_design(points, design, np.array([0.0, 0.1]))
    assert np.isnan(found[800:1200]).all() and np.isnan(found[1501:2499]).all()
    for part in (slice(0, 800), slice(1200, 1499), slice(2502, 3000)):
        assert found[part].max() < 1e-9
    across = 1e-4 * 0.05 / math.hypot(0.02, 0.05)
    np.testing.assert_allclose(found[3000:-1], across, rtol=1e-3)


def test_the_wound_mandrel_is_a_glb(vessel: Product, circuit: FloatArray, machine: Machine) -> None:
    """It is read by the specification of glTF 2.0: chunks, accessors, areas of all surfaces."""
    assert machine.tool is not None
    laid = Replay(vessel.surface, machine.tool, 0.2, vessel.tied).feed(_eyes(circuit, 2))
    fibre = np.column_stack([laid.u, laid.angle, laid.winding])
    fibre[~laid.known] = np.nan
    slips = np.arange(len(fibre)) >= len(fibre) - 20
    content = wound_glb(vessel.surface, vessel.width.si, fibre, slips, "two circuits")

    assert content[:4] == b"glTF"
    assert np.frombuffer(content[4:12], "<u4").tolist() == [2, len(content)]
    size = int.from_bytes(content[12:16], "little")
    described = json.loads(content[20 : 20 + size])
    data = content[28 + size :]
    assert len(content) % 4 == size % 4 == 0
    assert described["buffers"] == [{"byteLength": len(data)}]

    def array(number: int) -> FloatArray:
        accessor = described["accessors"][number]
        view = described["bufferViews"][accessor["bufferView"]]
        kind = "<f4" if accessor["componentType"] == 5126 else "<u4"
        part = data[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        width = {"VEC3": 3, "SCALAR": 1}[accessor["type"]]
        found = np.frombuffer(part, kind).reshape(accessor["count"], width)
        if "min" in accessor:
            np.testing.assert_array_equal(found.min(axis=0), np.float32(accessor["min"]))
        return found.astype(np.float64)

    area = {0: 0.0, 1: 0.0, 2: 0.0}
    for node in described["nodes"]:
        (primitive,) = described["meshes"][node["mesh"]]["primitives"]
        places = array(primitive["attributes"]["POSITION"])
        corners = places[array(primitive["indices"]).astype(int).reshape(-1, 3)]
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area[primitive["material"]] += 0.5 * float(np.linalg.norm(sides, axis=1).sum())
        radii = np.hypot(places[:, 1], places[:, 2])
        assert radii.max() < 0.0503 and radii.min() > 0.0279
    u = np.linspace(0.0, vessel.surface.length_m, 4001)
    mandrel = 2.0 * math.pi * float(np.trapezoid(vessel.surface.at(u)[1][:, 0], u))
    assert area[0] == pytest.approx(mandrel, rel=2e-3)
    length = float(laid.length_m[-1] - laid.length_m[1])
    assert area[1] + area[2] == pytest.approx(length * vessel.width.si, rel=0.02)
    slipping = float(laid.length_m[-1] - laid.length_m[-21])
    assert area[2] == pytest.approx(slipping * vessel.width.si, rel=0.1)
    assert [node["name"] for node in described["nodes"]][1] == "wound 0 to 5 %"


def test_coverage_says_how_much_of_the_fibre_it_does_not_know(
    vessel: Product, machine: Machine, circuit: FloatArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Untied, the first five free lengths of 40 mm are unknown: 0.2 m of two circuits."""
    assert machine.tool is not None
    eyes = _eyes(circuit, 2)
    covering = CoverageGap([WoundJob(vessel, machine.tool, machine.axis_names)], 3)
    replay = Replay(vessel.surface, machine.tool, 0.2)
    for part in np.array_split(eyes, 5):
        blank = np.zeros((len(part), 3))
        fibre = replay.feed(part)
        covering.take([Wound(blank[:, 0], None, blank, fibre, part)])
    share = re.search(r"the place of (\d+) % of the laid", covering.found().worst().note)
    length = programs.geodesic(vessel.surface)[0][-1]
    assert share is not None
    assert float(share[1]) == pytest.approx(100.0 * 0.2 / (2.0 * length), abs=1.5)
    assert covering.found().worst().note.endswith("and that fibre may lie in the gap")
    none = Gap(0.0, 0.0, -1, "")
    monkeypatch.setattr(Raster, "gap", lambda _: none)
    full = CoverageGap([WoundJob(vessel, machine.tool, machine.axis_names)], 3)
    fibre = Replay(vessel.surface, machine.tool, 0.2).feed(part)
    full.take([Wound(blank[:, 0], None, blank, fibre, part)])
    finding = full.found().worst()
    assert finding.value == 0.0
    assert re.fullmatch(
        r"the place of \d+ % of the laid fibre is not known, and that fibre counts as no cover: "
        "the rest leaves no gap", finding.note,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("slip", "message"), [(2e-4, "0.02% too little"), (-2e-4, "0.02% too far")]
)
def test_a_mandrel_that_slips_leaves_a_pattern_open_on_one_side(
    vessel: Product, machine: Machine, circuit: FloatArray, slip: float, message: str
) -> None:
    """44 circuits of 63/44 turns are 63 turns: 0.02 % of them are 4.5 degrees, 3.0 mm across."""
    assert machine.tool is not None
    product = replace(vessel, slip=Toleranced(slip), at=Toleranced(0.0))
    job = WoundJob(product, machine.tool, machine.axis_names)
    positions = _eyes(circuit, programs.CIRCUITS)[:, :3]
    closing, replay = PatternClosure([job], 3), job.replay()
    eyes = job.eyes(positions)
    fibre = replay.feed(eyes)
    closing.take([Wound(np.zeros(len(eyes)), None, positions, fibre, eyes)])
    away = closing.found().worst()
    cos = math.sqrt(1.0 - (programs.TURN_M / 0.05) ** 2)
    expected = abs(slip) * programs.TURNS * 2.0 * math.pi * 0.05 * cos
    assert away.value == pytest.approx(expected, abs=3e-4)
    assert message in away.note and "steps per degree or by slip" in away.note


def test_a_level_over_tolerances_draws_slip_and_friction(vessel: Product, machine: Machine) -> None:
    """200 products: every draw is within its tolerance, on both sides, and unlike the next."""
    assert machine.tool is not None
    product = replace(vessel, slip=Toleranced(0.0, 1e-3))
    drawn = product_at_random(np.arange(200))
    jobs = [WoundJob(product, machine.tool, machine.axis_names, tuple(parts)) for parts in drawn]
    slips = np.array([job.slip for job in jobs])
    frictions = np.array([job.friction for job in jobs])
    assert np.abs(slips).max() <= 1e-3 and slips.min() < -8e-4 and slips.max() > 8e-4
    assert frictions.min() >= 0.2 and frictions.max() <= 0.3 and np.ptp(frictions) > 0.09
    positions = np.ones((2, 3))
    turned = jobs[0].eyes(positions)[:, 0]
    np.testing.assert_allclose(turned, 1.0 - slips[0], rtol=1e-12)


@pytest.mark.parametrize("dialect", ["grbl", "marlin"])
def test_a_turn_that_is_set_to_zero_again_lays_the_same_fibre(tmp_path: Path, dialect: str) -> None:
    """Four turns, the same with G92 A0 after each block, and with one G92 half-way."""
    winder = load_machine(f"stepper-winder+xab+{dialect}")
    product = tmp_path / "c.wind.toml"
    product.write_text(
        '[[part]]\nkind = "cylinder"\nradius = "30 mm"\nlength = "200 mm"\n[band]\nwidth = "5 mm"\n'
        '[friction]\nvalue = "0.3"\n[fibre]\ntied = "20 mm"\n'
    )
    ends = []
    for zeroed in ((), range(1, 41), (20,)):
        rows, zero = ["G21", "G90", "G94", "G1 X20 F1000"], 0
        for k in range(1, 41):
            rows.append(f"G1 X{20 + k} A{36 * (k - zero)} F3000")
            if k in zeroed:
                rows.append("G92 A0")
                zero = k
        file = tmp_path / "p.gcode"
        file.write_text("\n".join([*rows, "M30", ""]))
        options = options_of(product=str(product), dialect=dialect)
        plan = plan_job(open_job(file, winder, options), winder, options)
        job = wound_job(plan)
        assert job is not None
        last = list(programmed_fibre(plan, job))[-1].fibre
        ends.append((float(last.u[-1]), float(last.angle[-1])))
    assert abs(ends[0][1]) > 3.5 * 2.0 * math.pi
    for end in ends[1:]:
        assert end == pytest.approx(ends[0], abs=1e-12)
