"""The fibre of whole jobs: a program that passes, and faults that fail at their lines."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.winding import programs
from threadline.base.arrays import FloatArray
from threadline.cli.main import main
from threadline.commands.plan import Plan
from threadline.errors import OptionError
from threadline.machine import Machine, load_machine
from threadline.proof.asked import Words
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
from threadline.report.proof import write_report
from threadline.search.compare import compare, placement_spec
from threadline.search.question import question_of
from threadline.search.studied import Studied
from threadline.verdict import Spec, load_spec
from threadline.verdict.fibre import (
    MEASURED,
    PLANNED,
    Closing,
    Near,
    _off_design,
    measure_planned,
)
from threadline.verdict.finding import Finding
from threadline.verdict.replayed import Wound, WoundJob
from threadline.winding.product import Product, product_of_text, product_text
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
    """Planned on the programmed chords: steering by rounding alone, no bridge and no lifting."""
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
    # Where it begins: the most is unwound in the next block, as the planner rounds the corner.
    assert _line(plan, finding) == faulty


def test_a_waist_is_bridged(tmp_path: Path, machine: Machine, circuit: FloatArray) -> None:
    """The program of the smooth vessel on a vessel with a waist of 5 mm over its cylinder."""
    plan = _plan(tmp_path, machine, programs.program(circuit, 1), WAIST)
    finding = _found(plan)["planned_bridging"]
    # Less than the depth of the waist: the fibre lies on the cone in front of it for a while.
    assert finding.value is not None and 5e-4 < finding.value < 5e-3
    assert FIRST_LINE < _line(plan, finding) < FIRST_LINE + len(circuit)


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
    # Bare is only where a missing band of one direction crosses one of the other.
    missing = _gap(vessel, machine, circuit, programs.TOO_FEW)
    assert 2e-3 < missing.width_m < 8e-3
    assert 0.0 < missing.share < 0.03
    assert missing.operation >= 0


def test_a_run_is_judged_like_its_plan(
    tmp_path: Path, machine: Machine, circuit: FloatArray
) -> None:
    """One circuit on the simulated machine: every measure has a value; a product stays recorded."""
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
    page = write_report(Studied(proof=proof), tmp_path / "report")
    names = {file.name for file in page.parent.iterdir()}
    assert {"report-winding-map.svg", "report-winding-along.svg"} <= names
    # The page names the product and does not quote it.
    assert "vessel.wind.toml, sha256" in page.read_text() and "isotensoid" not in page.read_text()


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
    """A program that only its fibre faults is out of spec for ``compare`` and ``yield`` as well."""
    file = tmp_path / "p.prg"
    file.write_text(programs.program(circuit, 1, programs.slipping(circuit)))
    options = options_of(product=str(VESSEL), interpolation="linear")
    job = open_job(file, machine, options)
    found = compare(job, machine, load_spec(None, machine), [options], with_fastest=False)
    failed = {r.name for r in found.proofs[0].verdict.results if r.status == "failed"}
    assert "slip_tendency" in failed and "contour_error" not in failed
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

    monkeypatch.setattr("threadline.cli.yield_.MachineYield", taken)
    with pytest.raises(SystemExit):
        main(["yield", str(file), "-m", "lathe-winder", "--product", str(VESSEL)])
    assert given[0] >= {"slip_tendency", "planned_lifting"}


def test_compile_says_who_takes_a_product(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["compile", "p.prg", "-m", "lathe-winder", "--product", "p.wind.toml"])
    assert ended.value.code == 2
    assert "compile takes no --product; prove, run, " in capsys.readouterr().err


def test_the_distance_of_the_eye_is_that_of_a_cylinder(tmp_path: Path) -> None:
    """A wandering eye beside, inside and beyond a cylinder, whose distance is a closed form."""
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
    blank = np.zeros((20_000, 3))
    found = Near([WoundJob(product, tool, ("A", "X", "Y"))])(
        Wound(blank[:, 0], None, blank, [], [eyes]), 0
    )
    x, out = eyes[:, 1], eyes[:, 2] - 0.05
    beyond = np.maximum(np.maximum(-x, x - 0.2), 0.0)
    distance = np.where(beyond > 0.0, np.hypot(beyond, np.maximum(out, 0.0)), out)
    # The ends are open: below their rims there is no face to keep away from.
    rim = (out < 0.0) & (np.minimum(x, 0.2 - x) < -out)
    wanted = np.maximum(0.003 - distance, 0.0)
    assert (wanted > 0.0).mean() > 0.1
    # The outline has a point every 25 um.
    np.testing.assert_allclose(found[~rim], wanted[~rim], atol=1.25e-5)


@pytest.mark.parametrize("circuits", [programs.CIRCUITS, programs.TOO_FEW, 3])
def test_a_pattern_closes_after_its_number_of_circuits(
    vessel: Product, machine: Machine, circuit: FloatArray, circuits: int
) -> None:
    """A circuit is 63/44 of a turn by number theory, and the fibre's angle is Clairaut's."""
    assert machine.tool is not None
    eyes = _eyes(circuit, circuits)
    job = WoundJob(vessel, machine.tool, machine.axis_names)
    closing = Closing([job], 3)
    replay = job.replay()
    for part in np.array_split(eyes, 7):
        fibre = replay.feed(part)
        blank = np.zeros((len(part), 3))
        closing.take(Wound(blank[:, 0], None, blank, [fibre], [part]))
    away = closing.found().worst()
    share = circuits * programs.TURNS / programs.CIRCUITS % 1.0
    share = min(share, 1.0 - share)
    cos = math.sqrt(1.0 - (programs.TURN_M / 0.05) ** 2)
    assert away.value == pytest.approx(share * 2.0 * math.pi * 0.05 * cos, abs=3e-4)
    assert f"after {circuits} circuits" in away.note


def test_the_design_is_found_again_where_the_fibre_was_not_known() -> None:
    """A helix of four turns, laid 0.1 mm beside in one part; neither it nor its design is whole."""
    angle = np.linspace(0.0, 8.0 * np.pi, 4001)
    length = angle * math.hypot(0.02, 0.05)
    helix = np.column_stack([0.02 * angle, 0.05 * np.cos(angle), 0.05 * np.sin(angle), length])
    design, points = helix.copy(), helix.copy()
    design[1500:2500, :3] = np.nan
    points[800:1200, :3] = np.nan  # more than the stretch that is searched from place to place
    points[3000:, 0] += 1e-4
    points[:, 3] += 0.04  # it laid more before its place was known
    found = _off_design(points, design, np.array([0.0, 0.1]))
    assert np.isnan(found[800:1200]).all() and np.isnan(found[1501:2499]).all()
    for part in (slice(0, 800), slice(1200, 1499), slice(2502, 3000)):
        assert found[part].max() < 1e-9
    across = 1e-4 * 0.05 / math.hypot(0.02, 0.05)
    np.testing.assert_allclose(found[3000:-1], across, rtol=1e-3)
