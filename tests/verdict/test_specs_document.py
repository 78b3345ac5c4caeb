"""The document on specifications agrees with the registry of measures."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from threadline.commands.plan import Stitched
from threadline.machine import load_machine
from threadline.units import parse_quantity
from threadline.verdict import load_spec
from threadline.verdict import spec as spec_module
from threadline.verdict.measure import OfPlan, OfRun, OfRuns
from threadline.verdict.registry import MEASURES
from threadline.verdict.stitch_run import StitchRun
from threadline.verdict.switch_run import SwitchRun
from threadline.verdict.types import Status

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "specs.md"
TEXT = DOCUMENT.read_text(encoding="utf-8")
UNITS = {
    "tool": {"m", "m at the tool"},
    "tool/s": {"m/s"},
    "axis": {"m or rad"},
    "axis/s": {"m/s or rad/s"},
    "axis/s^2": {"m/s^2 or rad/s^2"},
    "axis/s^3": {"m/s^3 or rad/s^3"},
    "time": {"s"},
    "current": {"A"},
    "rate": {"Hz"},
    "ratio": {"a share"},
    "stitch": {"stitch"},
}


def part(heading: str) -> str:
    """Return the text under a heading."""
    return re.split(r"\n##+ ", re.split(rf"^#+ {re.escape(heading)}$", TEXT, flags=re.M)[1])[0]


def measures(text: str) -> dict[str, list[str]]:
    """Return the rows of a table of measures, by name."""
    rows = [[c.strip() for c in line.strip("|").split("|")] for line in text.splitlines()]
    return {row[0].strip("`"): row for row in rows if len(row) == 6 and row[0].startswith("`")}


def test_every_measure_has_its_row_and_no_other_has() -> None:
    assert set(measures(TEXT)) == set(MEASURES)
    for heading, own in (
        ("On/off machines only", (SwitchRun,)),
        ("Embroidery machines only", (StitchRun, Stitched)),
    ):
        only = {
            name
            for name, kind in MEASURES.items()
            if all(
                (r.run if isinstance(r, OfRun) else r.intent) in own
                for r in kind.reads
                if isinstance(r, OfRun | OfPlan)
            )
            and not any(isinstance(r, OfRuns) for r in kind.reads)
        }
        assert set(measures(part(heading))) == only


@pytest.mark.parametrize("name", MEASURES)
def test_a_row_says_what_the_measure_is(name: str) -> None:
    kind = MEASURES[name]
    _, meaning, unit, of, needs, options = measures(TEXT)[name]

    assert meaning
    assert unit in UNITS[kind.dimension]
    assert of == ("each axis" if kind.per_axis else "the tool")
    for alternatives in kind.needs:
        assert " or ".join(f"`{channel}`" for channel in alternatives) in needs
    if all(isinstance(reading, OfPlan) for reading in kind.reads):
        assert needs == "plan"
    values = {o: text for o, text in re.findall(r"`(\w+)` ([\d.]+ ?(?:mm|ms|s)?)", options)}
    assert set(values) == set(kind.options)
    for option, text in values.items():
        expected = kind.options[option]
        has_unit = text.strip()[-1].isalpha()
        value = parse_quantity(text, expected.unit) if has_unit else float(text)
        assert value == pytest.approx(expected.default, abs=1e-12)


def test_every_key_and_status_is_named() -> None:
    keys = part("Keys")
    for key in {*spec_module.TOP_KEYS, *spec_module.COMMON_KEYS, "step"} - {"criteria"}:
        assert f"| `{key}` |" in keys
    assert "[[criteria]]" in keys
    for status in Status:
        assert f"| `{status.value}` |" in part("Results")


def test_document_lists_the_criteria_judged_by_default(tmp_path: Path) -> None:
    """Two paragraphs name the criteria that are judged in addition to the named ones."""
    paragraphs = part("What is judged without being named").strip().split("\n\n")
    for text, machine, named in zip(
        paragraphs, ("lathe-winder", "letter-placer"), ("current_rms", "current_peak"), strict=True
    ):
        file = tmp_path / f"{machine}.toml"
        file.write_text(f'name = "x"\n[[criteria]]\nname = "{named}"\n')
        spec = load_spec(file, load_machine(machine))
        given = {c.name for c in spec.criteria} - {named}
        limited, reported = " ".join(text.split()).split("are judged with the machine's limits", 1)
        own = {c.name for c in spec.criteria if c.hard}
        assert set(re.findall(r"`(\w+)`", limited)) == own
        assert given - own <= set(re.findall(r"`(\w+)`", reported))


def test_the_example_is_read_as_it_is_explained(tmp_path: Path) -> None:
    (block,) = re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)
    file = tmp_path / "spec.toml"
    file.write_text(block, encoding="utf-8")
    machine = load_machine("lathe-winder")
    spec = load_spec(file, machine)
    found = {(c.name, c.axis): c for c in spec.criteria}

    assert spec.lag_s == pytest.approx(0.080)
    contour = found["contour_error", ""]
    assert contour.limit == pytest.approx(0.4e-3)
    assert contour.required
    assert [axis for name, axis in found if name == "turning_point_error"] == ["Y"]
    assert found["settling_time", ""].options["band"] == pytest.approx(0.2e-3)
    assert found["velocity", "X"].limit == machine.axes["X"].velocity.si
    assert found["acceleration", "X"].limit == pytest.approx(6.0)
    assert found["current_peak", "X"].limit is None
    assert found["jerk", "X"].limit == machine.axes["X"].jerk.si
