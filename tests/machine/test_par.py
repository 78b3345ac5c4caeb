"""FW-CNC.PAR as printed in the thesis, and as it was planned."""

from __future__ import annotations

from pathlib import Path

import pytest

from threadline.errors import MachineError, OptionError
from threadline.machine import load_machine
from threadline.machine.par import read_parameters
from threadline.proof.option_form import Door
from threadline.proof.request import Words
from threadline.search.design_question import DesignAims, design_question
from threadline.search.design_space import design_space

MACHINE = load_machine("lathe-winder")
PRINTED = """\
FW-CNC.PAR  --  CNC filament winding machine parameters file
First three lines are for comments, all the other lines are also
formatted bearing an integer and a comment beginning with <;>.
20  ; Initial feed rate for manual control
10  ; Normal feed rate
30  ; Feed rate limit
20  ; Number of interrupts after which actual positions are recorded
4   ; Number of knot points to be interpolated between two points
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "FW-CNC.PAR"
    path.write_bytes(text.encode("latin-1"))
    return path


def test_the_printed_file_is_what_the_library_machine_has(tmp_path: Path) -> None:
    """The library's operator table was typed from the same page: the five numbers agree."""
    machine = read_parameters(write(tmp_path, PRINTED), MACHINE)
    assert machine.operator is not None and MACHINE.operator is not None
    for name in ("manual_feed", "normal_feed", "limit_feed", "record_every", "knots_between"):
        mine, library = getattr(machine.operator, name), getattr(MACHINE.operator, name)
        assert (mine.si, mine.unit) == (library.si, library.unit)
    assert machine.operator.normal_feed.note == "FW-CNC.PAR:5"
    assert machine.controllers == MACHINE.controllers


def test_other_numbers_make_another_machine(tmp_path: Path) -> None:
    """DOS line ends and end-of-file mark are read; the hash tells the machines apart."""
    text = PRINTED.replace("10  ; Normal", "25  ; Normal").replace("\n", "\r\n") + "\x1a"
    machine = read_parameters(write(tmp_path, text), MACHINE)
    assert machine.operator is not None
    assert machine.operator.normal_feed.si == 25.0
    assert machine.sha256 != MACHINE.sha256


def test_axes_and_gains_as_the_thesis_planned(tmp_path: Path) -> None:
    """Two axes, each with its gains; the third and its switches are left out."""
    gains = "2 ; axes\n3 ; Kp of A\n5 ; Kd of A\n2 ; Kp of X\n4 ; Kd of X\n"
    machine = read_parameters(write(tmp_path, PRINTED + gains), MACHINE)
    assert machine.axis_names == ("A", "X")
    assert {switch.axis for switch in machine.inputs.values()} == {"X"}
    controllers = [machine.controllers[machine.axes[name].controller] for name in ("A", "X")]
    assert [(c.kp.si, c.kd.si) for c in controllers] == [(3.0, 5.0), (2.0, 4.0)]
    both = read_parameters(write(tmp_path, PRINTED + "3 ; axes\n6 ; Kp\n7 ; Kd\n"), MACHINE)
    assert {c.kp.si for c in both.controllers.values()} == {6.0}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"FW-CNC.PAR: the file has 0 numbers .* 'manual feed' is missing"),
        (PRINTED[:210], r"FW-CNC.PAR:4: .* 'normal feed' is missing|FW-CNC.PAR:4: '20 .*"),
        (PRINTED.replace("10  ;", "10,5 ;"), r"FW-CNC.PAR:5: '10,5 ; Normal feed rate' is not"),
        (PRINTED.replace("10  ;", "31 ;"), r"FW-CNC.PAR:5: normal feed is 31 count/tick, above"),
        (PRINTED.replace("4   ;", "0 ;"), r"FW-CNC.PAR:8: knots between is 0"),
        (PRINTED.replace("30  ;", "-3 ;"), r"FW-CNC.PAR:6: -3 is not from 0"),
        (PRINTED.replace("20  ; Num", "99999 ; Num"), r"FW-CNC.PAR:7: .* every 99999 ticks"),
        (PRINTED + "4 ; axes\n", r"FW-CNC.PAR:9: the number of axes is 4; 'lathe-winder' has 3"),
        (PRINTED + "3 ; axes\n1 ; Kp\n", r"FW-CNC.PAR:10: 1 gains for 3 axes"),
        ("x" * 200_000, r"more than 100000 bytes"),
    ],
)  # fmt: skip
def test_a_wrong_file_gets_one_line(tmp_path: Path, text: str, message: str) -> None:
    """File, line and fault."""
    with pytest.raises(MachineError, match=message) as caught:
        read_parameters(write(tmp_path, text), MACHINE)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    """Without a traceback of the operating system."""
    with pytest.raises(MachineError, match=r"cannot read parameter file .*No such file"):
        read_parameters(tmp_path / "none.par", MACHINE)


def test_a_redesign_keeps_the_settings_unless_it_changes_them(tmp_path: Path) -> None:
    """A redesigned gain would be replaced again by the settings of the same file."""
    par = write(tmp_path, PRINTED + "3 ; axes\n6 ; Kp\n7 ; Kd\n")
    (tmp_path / "mine.toml").write_text(
        'base = "lathe-winder"\nname = "mine"\n[design.parameters.gains]\n'
        'of = ["controllers.x.kp"]\nfactor = [0.5, 2]\n'
    )
    given = Words.of("design", Door.PYTHON, {"par": par})
    asked = design_question(given, tmp_path / "a.prg", given.machine("lathe-winder"), DesignAims())
    assert asked.machine.parameters == str(par)
    assert design_space(asked.machine).names == ("rotors", "amplifiers")
    changed = given.machine(tmp_path / "mine.toml")
    with pytest.raises(OptionError, match=r"gains changes controllers\.x\.kp, and --par"):
        design_space(changed)
    assert "gains" in design_space(load_machine(tmp_path / "mine.toml")).names
