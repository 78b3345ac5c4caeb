"""Products within their tolerances, and the cause that gaps point to, by closed forms."""

from __future__ import annotations

import math
from contextvars import ContextVar
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.winding import programs
from threadline.base.arrays import FloatArray
from threadline.cli.prove import product_lines
from threadline.commands.plan import Plan
from threadline.files import Stream
from threadline.machine import Machine, load_machine
from threadline.proof import judge_runs
from threadline.proof.judge_runs import cached_in_memory
from threadline.proof.options import options_of
from threadline.proof.pipeline import NOMINAL, open_job, plan_job, prove_plan, with_shaping
from threadline.proof.worst_machine import WithinTolerances
from threadline.proof.worst_search import WorstSearch, most_searched
from threadline.search.machine_yield import MachineYield
from threadline.verdict import laid_error, load_spec
from threadline.verdict.causes import Causes, causes_of
from threadline.verdict.replayed import NUMBERS, product_of, product_words, toleranced
from threadline.winding.product import product_of_text, product_text

VESSEL = Path(__file__).parents[2] / "examples" / "vessel.wind.toml"
CIRCUITS = 12
ENOUGH = ("slip_tendency", "free_length", "lifting", "coverage_gap", "clearance", "slack")


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("lathe-winder")


def _plan(folder: Path, machine: Machine, circuits: int, product: Path = VESSEL) -> Plan:
    surface = product_of_text(product_text(VESSEL)).surface
    circuit = programs.eyes(surface, programs.geodesic(surface)[1])
    file = folder / "p.prg"
    file.write_text(programs.program(circuit, circuits))
    options = options_of(product=str(product), interpolation="linear")
    return plan_job(open_job(file, machine, options), machine, options)


def test_numbers_of_the_product_vary_beside_those_of_the_machine(
    tmp_path: Path, machine: Machine
) -> None:
    """A product at the ends of its tolerances is judged like a product file with those numbers."""
    plan = _plan(tmp_path, machine, 1)
    spec = with_shaping(load_spec(None, machine), machine, options_of(product=str(VESSEL)))
    within = WithinTolerances(plan, spec, threads=1, with_product=True)
    product = product_of(plan)
    assert product is not None
    reason = "as in the product file"
    same = MachineYield(plan, spec, threads=1).same
    assert {name for name, why in same.items() if reason in why} == {
        "mandrel.radius_error", "mandrel.at", "band.width", "friction.value"
    }  # fmt: skip
    varying = [NUMBERS[k] for k in toleranced(product)]
    assert varying == ["mandrel.radius_error", "mandrel.at", "band.width", "friction.value"]
    assert len(within.ends) == len(within.numbers) + 4
    ends = dict(zip(varying, (-1.0, 1.0, 1.0, 0.0), strict=True))
    parts = np.zeros((2, len(within.ends)))
    parts[1, len(within.numbers) :] = list(ends.values())
    reports: list[float] = []
    asking: ContextVar[str] = ContextVar("asking")
    asking.set("this command")
    # Threads report progress to the calling command; otherwise it would be silent for minutes.
    found = within.judged(parts, lambda count: reports.append(count) if asking.get("") else None)
    assert sum(reports) == pytest.approx(2.0)

    text = VESSEL.read_text()
    for old, new in (
        ("100 mm +- 0.5 mm", "100.5 mm"), ("0 mm +- 0.1 mm", "-0.1 mm"),
        ("5.6 mm +- 0.1 mm", "5.7 mm"),
    ):  # fmt: skip
        assert old in text
        text = text.replace(old, new)
    other = tmp_path / "other.wind.toml"
    other.write_text(text)
    moved = prove_plan(_plan(tmp_path, machine, 1, other), spec, None, NOMINAL).verdict
    proof = prove_plan(plan, spec, None, NOMINAL)
    own = proof.verdict
    changed = 0
    for name in ENOUGH:
        for run, verdict in enumerate((own, moved)):
            result = next(one for one in verdict.results if one.name == name)
            assert found.row(name).values[run] == pytest.approx(result.measured, rel=1e-9), name
        changed += found.row(name).values[0] != found.row(name).values[1]
    assert changed >= 4
    assert product_words(product, ends) == (
        "mandrel.radius_error = -0.1 mm, mandrel.at = 100.5 mm, band.width = 5.7 mm, "
        "friction.value = 0.25"
    )
    assert not product_lines(proof)
    worst = within.worst_at(parts[1], 1.0, "")
    assert worst.product == {name: at for name, at in ends.items() if at}
    (line,) = product_lines(replace(proof, worst=worst))
    assert line.endswith(
        "--product: mandrel.radius_error = -0.1 mm, mandrel.at = 100.5 mm, band.width = 5.7 mm"
    )


def test_many_machines_share_the_design_and_the_plan(
    tmp_path: Path, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A winding of half an hour is planned, and its design replayed, once for all machines."""
    options = options_of(product=str(VESSEL), interpolation="linear")
    file = tmp_path / "rests.prg"
    file.write_text("G90\nG1 X10 F100\nG4 P1500\nG1 X0\nM30\n")
    plan = plan_job(open_job(file, machine, options), machine, options)
    assert plan.duration_s > 1500.0
    cached = cached_in_memory(plan)
    assert cached is not plan and isinstance(cached.commands.blocks, Stream)
    monkeypatch.setattr(judge_runs, "CACHED_TICKS", 1000)
    assert cached_in_memory(plan) is plan

    counted: list[int] = []
    read = laid_error.programmed_fibre

    def counting(*given: object) -> object:
        counted.append(1)
        return read(*given)

    monkeypatch.setattr(laid_error, "programmed_fibre", counting)
    circuit = _plan(tmp_path, machine, 1)
    spec = with_shaping(load_spec(None, machine), machine, options_of(product=str(VESSEL)))
    within = WithinTolerances(circuit, spec, threads=1, with_product=True)
    parts = np.zeros((2, len(within.ends)))
    first = within.judged(parts).row("laid_error").values
    np.testing.assert_array_equal(within.judged(parts).row("laid_error").values, first)
    assert len(counted) == 1


class _Replayed:
    together, replayed = True, True

    def __init__(self, ticks: int) -> None:
        self.ticks = ticks


def test_a_search_tries_fewer_machines_of_a_long_winding() -> None:
    """50 million ticks of replayed runs; at least as many machines as one by one, at most all."""
    for ticks, most in ((0, 1200), (10_000, 1200), (100_000, 500), (400_000, 125), (10**7, 60)):
        within = _Replayed(ticks)
        assert most_searched(within) == most  # type: ignore[arg-type]
        assert WorstSearch(within).most == most  # type: ignore[arg-type]
    plain = _Replayed(400_000)
    plain.replayed = False  # type: ignore[misc]
    assert most_searched(plain) == 1200  # type: ignore[arg-type]


def _gaps(turn: float, circuits: int, width_m: float) -> FloatArray:
    """Return the gaps between bands that are a turn apart, round 50 mm."""
    angle = np.sort((turn * np.arange(circuits)) % (2.0 * math.pi))
    across = 0.05 * math.sqrt(1.0 - (programs.TURN_M / 0.05) ** 2)
    return across * np.diff(angle, append=angle[0] + 2.0 * math.pi) - width_m


@pytest.fixture(scope="module")
def causes(machine: Machine, tmp_path_factory: pytest.TempPathFactory) -> Causes:
    found = causes_of(_plan(tmp_path_factory.mktemp("p"), machine, CIRCUITS))
    assert found is not None
    return found


def test_each_factor_changes_the_gaps_as_by_its_closed_form(causes: Causes) -> None:
    """Band: all gaps alike. Turn: by the circuits between two bands. Zero: both ends, no gap."""
    turn = programs.circuit_turn(product_of_text(product_text(VESSEL)).surface)
    width = causes.width_m
    seen = len(causes.laid.gaps_m)
    assert seen in (CIRCUITS, CIRCUITS - 1)
    gaps = _gaps(turn, seen, width)
    np.testing.assert_allclose(np.sort(causes.laid.gaps_m), np.sort(gaps), atol=3e-5)
    by_name = {cause.name: cause for cause in causes.causes}
    band = by_name["width of the band"]
    assert band.mean_m == pytest.approx(-1e-4, abs=1e-9)
    assert band.largest_m == pytest.approx(-1e-4, abs=1e-9)
    slip = by_name["steps per degree, or slip"]
    slipped = _gaps(turn * (1.0 - slip.by), seen, width)
    assert slip.largest_m == pytest.approx(slipped.max() - gaps.max(), rel=0.02, abs=1e-6)
    assert abs(slip.mean_m) < 0.05 * abs(slip.largest_m)
    zero = by_name["zero along the mandrel"]
    assert abs(zero.largest_m) < 1e-5
    assert zero.left_m == pytest.approx(zero.right_m, abs=5e-5) and abs(zero.left_m) > 1e-4
    radius = by_name["radius of the mandrel"]
    # A larger mandrel has more room between equally many bands.
    assert radius.mean_m > 0.0


def test_the_shape_of_the_gaps_names_what_they_point_to(causes: Causes) -> None:
    width = causes.width_m

    def words(gaps: FloatArray) -> str:
        laid = replace(causes.laid, gaps_m=gaps)
        return replace(causes, laid=laid).words()

    turn, all_of_them = 2.0 * math.pi * programs.TURNS / programs.CIRCUITS, programs.CIRCUITS
    assert words(_gaps(turn, all_of_them, width)).endswith("the bands leave no gap")
    assert "all gaps are alike" in words(_gaps(turn, all_of_them, width - 1e-3))
    assert "4 bands would fit" in words(_gaps(turn, programs.TOO_FEW, width))
    assert "adds up over the circuits" in words(_gaps(turn * 1.0003, all_of_them, width))
    laid = replace(causes.laid, gaps_m=_gaps(turn, all_of_them, width - 1e-3))
    rows = {row[0]: row[-1] for row in replace(causes, laid=laid).rows()}
    # Gaps of 0.9 mm and the overlap of a closed pattern, 0.1 mm: a band of 5.5 mm, not 5.6.
    assert rows["width of the band"] == f"-{1e3 * laid.largest_m:.2g} mm (8.9 tolerances)"
    assert not rows["zero along the mandrel"]
