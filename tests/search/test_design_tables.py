"""The table ``[design]`` of a machine file: known answers, and refusals with the line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from threadline.errors import MachineError
from threadline.machine import Machine, load_machine
from threadline.search.design_search import known_points
from threadline.search.design_space import design_space


@pytest.fixture(scope="module")
def stitcher() -> Machine:
    return load_machine("stitcher")


def test_known_answers_are_in_the_machine_file(stitcher: Machine) -> None:
    """The thesis proposes 100 times the stiffness and half the mass."""
    space = design_space(stitcher)
    (thesis,) = known_points(space).values()
    factors = dict(zip(space.names, np.exp(thesis), strict=True))
    assert factors["belt"] == pytest.approx(100)
    assert factors["frame"] == pytest.approx(100)
    assert factors["load"] == pytest.approx(0.5)
    assert factors["current"] == factors["friction"] == 1.0
    # 27 to 60 A is one factor; the load's measured damping is no parameter.
    assert np.exp(space.high[space.names.index("current")]) == pytest.approx(60 / 27)
    assert not any("head.damping" in path for paths in space.paths for path in paths)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('of = ["links.x_belt.stifness"]\nfactor = [1, 2]', "links.x_belt.stifness"),
        ('of = ["links.x_belt.stiffness"]\nfactor = [2, 1]', "factor runs from 2 to 1"),
        ('of = ["links.x_belt.stiffness"]', "either factor"),
        ('of = ["links.x_belt.stiffness"]\nfactr = [1, 2]', "factr"),
        ('of = ["axes.X.velocity"]\nfactor = [1, 2]', "axes.X.velocity"),
        ('of = ["links.x_belt.stiffness"]\nrange = ["1 kg", "2 kg"]', "range"),
        (
            'of = ["links.x_belt.stiffness", "links.y_belt.stiffness"]\nrange = ["1 N/m", "9 N/m"]',
            "equal",
        ),
        ('of = ["links.x_belt.stiffness"]\nfactor = ["1", "2"]', "must be a number, got '1'"),
        (
            'of = ["controllers.x.dac.bits"]\nfactor = [1, 2]',
            "mine.toml:4: design.parameters.extra: controllers.x.dac.bits takes whole numbers",
        ),
        ('of = ["links.x.stiffness"]\nfactor = [1, 2]', "mine.toml:4: design.parameters.extra"),
        (
            'of = ["links.x_belt.stiffness"]\nrange = ["1 kg", "2 kg"]',
            "mine.toml:5: design.parameters.extra.range",
        ),
        (
            'of = ["bodies.x_head.inertia"]\nfactor = [1, 2]',
            "mine.toml:4: design.parameters.extra.of: bodies.x_head.inertia is in both 'load'",
        ),
    ],
)
def test_a_wrong_table_is_refused_with_its_file(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        f'base = "stitcher+rigid-frame"\nname = "mine"\n[design.parameters.extra]\n{text}\n'
        '[design.parameters]\nbelt = "none"\n[design.known]\nthesis = "none"\n'
    )
    with pytest.raises(MachineError) as refused:
        design_space(load_machine(file))
    assert words in str(refused.value)
    assert "mine.toml" in str(refused.value)


def test_a_machine_without_the_table_says_so() -> None:
    with pytest.raises(MachineError, match=r"has no \[design\] table"):
        design_space(load_machine("stitcher-rigid"))


CROSSOVER = 'crossover = ["6 Hz exact, assumed", "{} exact, assumed"]\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"[design.settings]\n{CROSSOVER.format('1e9 Hz')}", "4: design.settings.crossover: it re"),
        (
            '[design.settings]\nphase_margin = ["60 deg exact, assumed", "300 deg exact, assumed"]',
            "4: design.settings.phase_margin: it reaches 300 deg, limit 90 deg",
        ),
        (
            '[design.settings]\nneedle_delay = ["9 ms exact, assumed", "4 ms exact, assumed"]',
            "4: design.settings.needle_delay: it runs from 0.009 to 0.004 s",
        ),
        (
            '[design.known.mine]\ntitle = "a"\nfactors = { belt = 2, frome = 2 }',
            "5: design.known.mine.factors: 'frome' is not a parameter; there are: belt, frame",
        ),
        (
            "".join(
                f'[design.parameters.p{k}]\nof = ["links.l{k}.stiffness"]\nfactor = [1, 2]\n'
                for k in range(4)
            ),
            "12: design.parameters: must have at most 8 entries, got 9. Take some out.",
        ),
        (
            '[design.parameters.current]\ntolerance = "1 %"\n'
            '[design.parameters.friction]\ntolerance = "1 %"',
            "6: design.parameters.friction.tolerance: 5 parameters have a tolerance, limit 4",
        ),
    ],
)
def test_check_of_the_whole_design_table_names_a_line(
    tmp_path: Path, text: str, words: str
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(f'base = "stitcher"\nname = "mine"\n{text}\n')
    with pytest.raises(MachineError) as refused:
        design_space(load_machine(file))
    assert f"mine.toml:{words}" in str(refused.value)
    assert len(str(refused.value)) < 300


def test_a_crossover_lies_below_half_the_clock_of_the_controller(
    tmp_path: Path, stitcher: Machine
) -> None:
    """Above it a sampled loop has no frequencies; just below it the search is allowed."""
    nyquist_hz = 0.5 / float(stitcher.clock(stitcher.controllers["x"].clock).period_s)
    file = tmp_path / "mine.toml"
    for share in (0.999, 1.0):
        written = CROSSOVER.format(f"{share * nyquist_hz!r} Hz")
        file.write_text(f'base = "stitcher"\nname = "mine"\n[design.settings]\n{written}')
        if share < 1.0:
            design_space(load_machine(file))
            continue
        with pytest.raises(MachineError, match=f"none at {nyquist_hz:g} Hz or above"):
            design_space(load_machine(file))
