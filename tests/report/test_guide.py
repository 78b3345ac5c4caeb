"""The guide to a machine: its figures, compared with the print or a closed form."""

from __future__ import annotations

from pathlib import Path

import pytest

from threadline.cli.main import main
from threadline.errors import MachineError
from threadline.machine import library_names, load_machine
from threadline.report.guide import full_stroke_s, guide_of, speed_at


def test_the_speed_at_a_voltage_is_that_of_the_printed_plant() -> None:
    """570 Kamp / (s (s + 46.7)), 12.2 rad/s a volt at Kamp 1; its Kt and Ke agree to 0.5 %."""
    machine = load_machine("lathe-winder")
    for axis, name in enumerate(machine.axes):
        rad_s = 570.0 / 46.7 * 0.45 * 2.5
        counts_s = rad_s * 4000 / 6.283185307
        going = speed_at(machine, name, 2.5)
        assert going is not None
        assert going * machine.counts_per_unit[axis] == pytest.approx(counts_s, rel=5e-3)
    assert speed_at(load_machine("lathe-winder+current"), "X", 2.5) is None


def test_a_full_stroke_takes_what_the_data_sheet_says() -> None:
    """200 mm in 0.79 s, as printed; the formula leaves out the air, a percent of it."""
    assert full_stroke_s(load_machine("letter-placer"), "X") == pytest.approx(0.79, rel=0.01)


@pytest.mark.parametrize("name", library_names())
def test_every_machine_has_a_guide(name: str) -> None:
    """Every axis and cylinder, every signal in the file, and a way to set up each."""
    machine = load_machine(name)
    axes, signals, *_, steps = guide_of(machine).tables
    words = " ".join(cell for table in (axes, signals, steps) for row in table.rows for cell in row)
    for part in (*machine.axes, *machine.cylinders, *machine.inputs, *machine.outputs,
                 *machine.contacts):  # fmt: skip
        assert part in words
    for moving in machine.moving:
        assert any(f"{moving} " in row[1] or f" {moving}" in row[1] for row in steps.rows)
    assert [row[0] for row in steps.rows] == [str(k + 1) for k in range(len(steps.rows))]


def test_the_winder_has_the_connectors_of_its_print() -> None:
    """Nine of them; the pins of appendix B."""
    connectors = load_machine("lathe-winder").guide.connectors
    assert list(connectors) == [f"CN{k}" for k in range(1, 10)]
    assert connectors["CN1"].pins["17"] == "X encoder line 1"
    assert connectors["CN6"].pins["F"] == "Y motor MT2"
    steps = guide_of(load_machine("lathe-winder")).tables[-1].rows
    assert sum("BALANCE" in row[1] for row in steps) == 1


def test_the_command_writes_a_page_and_a_pdf(tmp_path: Path) -> None:
    """A user's own connector is shown as text, whatever it contains."""
    own = tmp_path / "mine.toml"
    own.write_text(
        'base = "letter-placer"\nname = "mine"\n[guide.connectors.X1]\ntitle = "<b>valves</b>"\n'
        'pins = { 1 = "24 V & more" }\n', "utf-8",
    )  # fmt: skip
    with pytest.raises(SystemExit) as ended:
        main(["guide", str(own), "-o", str(tmp_path / "guide")])
    assert ended.value.code in (None, 0)
    page = (tmp_path / "guide" / "guide.html").read_text("utf-8")
    assert "&lt;b&gt;valves&lt;/b&gt;" in page
    assert "24 V &amp; more" in page
    assert (tmp_path / "guide" / "guide.pdf").read_bytes()[:5] == b"%PDF-"


def test_a_pin_without_a_name_is_refused(tmp_path: Path) -> None:
    """One line with the place."""
    own = tmp_path / "mine.toml"
    own.write_text(
        'base = "letter-placer"\nname = "mine"\n[guide.connectors.X1]\ntitle = "valves"\n'
        'pins = { "pin one" = "24 V" }\n', "utf-8",
    )  # fmt: skip
    with pytest.raises(MachineError, match=r"mine\.toml:5"):
        load_machine(own)
