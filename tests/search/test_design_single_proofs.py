"""The smallest change for machines that are simulated one by one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from threadline.errors import MachineError, OptionError
from threadline.machine import load_machine
from threadline.machine.numbers import number_at
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, Trials, prove
from threadline.search.design import Requirements, design, write_design
from threadline.search.design_evaluate import Effort
from threadline.search.design_single_proofs import share_used
from threadline.verdict import Result, Status, Verdict, load_spec

EXAMPLES = Path(__file__).parents[2] / "examples"
FEW = Effort(sample_log2=3, settings_log2=0, proposals=8, rounds=4, trade_rounds=0, side=0)
JOBS = {
    "letter-placer": ("letter-cycle.toml", Options()),
    "table-embroiderer": ("rosette.dst", Options(feed=parse_feed("800 stitch/min"))),
    "stepper-winder": ("helix.gcode", Options()),
}
CLOSE = """
name = "close"
[[criteria]]
name = "tracking_error"
axis = "A"
limit = "0.18 deg"
"""


@pytest.mark.long(but="stepper-winder")
@pytest.mark.parametrize("name", JOBS)
def test_found_design_is_in_spec_by_prove(name: str, tmp_path: Path) -> None:
    """The unchanged machine is out of spec; the written files are proved as they are."""
    file, options = JOBS[name]
    machine = load_machine(name)
    spec = load_spec(None, machine)
    if name == "stepper-winder":
        (tmp_path / "close.toml").write_text(CLOSE)
        spec = load_spec(tmp_path / "close.toml", machine)
    trials = Trials(repeats=2)
    result = design(
        EXAMPLES / file, machine, spec, options, Requirements(trials=trials, effort=FEW)
    )
    assert not prove(EXAMPLES / file, machine, spec, options, None, NOMINAL).verdict.passed
    assert result.as_built.ratio > 1.0 and result.found is not None
    assert result.found.candidate.cost > 0.0 and result.found.candidate.ratio <= 1.0
    for path, value in result.found.numbers.items():
        (parameter,) = (p for p in result.space.names if path in _of(result, p))
        factor = result.found.candidate.factors[parameter]
        assert value == pytest.approx(factor * number_at(machine, path).si, rel=1e-12)

    written = write_design(result, result.found, tmp_path / "found.toml")
    assert [p.name for p in written] == ["found.toml", "found.spec.toml"]
    again = load_machine(tmp_path / "found.toml")
    own = load_spec(None, again)
    proof = prove(EXAMPLES / file, again, own, options, None, trials)
    assert proof.verdict.passed
    assert share_used(proof.verdict)[0] == pytest.approx(result.found.candidate.ratio, rel=1e-6)


def _of(result, parameter: str) -> tuple[str, ...]:
    return result.machine.design.parameters[parameter].of


def test_shares_are_of_the_specification_and_of_broken_limits() -> None:
    """A kept limit of the machine does not count; a result that is not proven counts 1000."""

    def of(name: str, measured: float | None, *, hard: bool = False, required: bool = False):
        limit = 1.0
        status = Status.NOT_MEASURED
        if measured is not None:
            status = Status.PASSED if measured <= limit else Status.FAILED
        return Result(
            name=name, axis="", measured=measured, limit=limit, unit="s", status=status,
            hard=hard, required=required,
        )  # fmt: skip

    def share(*results: Result) -> tuple[float, str]:
        return share_used(Verdict(results=results, simulated=True))

    assert share(of("velocity", 1.0, hard=True), of("a", 0.5)) == (0.5, "a")
    assert share(of("velocity", 1.2, hard=True), of("a", 0.5)) == (1.2, "velocity")
    assert share(of("a", 0.5), of("b", None, required=True)) == (1e3, "b")
    assert share(of("a", np.inf)) == (1e3, "a")
    assert share() == (0.0, "")


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("letter-placer", 'acceleration = ["50 % exact, assumed", "100 % exact, assumed"]',
         "letter-placer has no axis with such a limit"),
        ("stepper-winder", 'crossover = ["6 Hz exact, assumed", "9 Hz exact, assumed"]\n'
         'phase_margin = ["50 deg exact, assumed", "60 deg exact, assumed"]',
         "stepper-winder has no controller"),
    ],
)  # fmt: skip
def test_settings_of_what_a_machine_lacks_are_refused(
    name: str, settings: str, words: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(f'base = "{name}"\n[design.settings]\n{settings}\n')
    job, options = JOBS[name]
    machine = load_machine(file)
    with pytest.raises(MachineError, match=words) as caught:
        design(EXAMPLES / job, machine, load_spec(None, machine), options)
    assert "mine.toml:3: design.settings" in str(caught.value)


def test_options_that_a_kind_lacks_are_refused_before_the_work() -> None:
    machine = load_machine("letter-placer")
    with pytest.raises(OptionError, match="switches cylinders on and off"):
        design(
            EXAMPLES / "letter-cycle.toml", machine, load_spec(None, machine),
            Options(interpolation="optimal"),
        )  # fmt: skip
