"""The document on machine files agrees with the model of a machine."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tools import machine_reference as reference

from threadline.dynamics.analysis import unstable_loops
from threadline.dynamics.plausibility import plausibility_warnings
from threadline.machine import load_machine
from threadline.machine.numbers import field_node, plain_node
from threadline.machine.quantity import Provenance

TEXT = (reference.PAGE.parent / "machines.md").read_text(encoding="utf-8")
KEYS = reference.PAGE.read_text(encoding="utf-8")


def section(heading: str) -> str:
    """Return the text under a heading of the document."""
    parts = re.split(r"^## (.+)$", TEXT, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))[heading]


def test_the_tables_of_keys_are_those_of_the_declarations() -> None:
    """``python -m tools.machine_reference`` writes them; each key has a description."""
    made = reference.page(KEYS)
    assert made == KEYS
    rows = [line.split(" | ") for line in made.splitlines() if line.startswith("| `")]
    assert [row[0] for row in rows if len(row) == 4 and not row[1].strip()] == []
    row = "| `stiction` | Force at breakaway, at least `friction` | N, N*m | `friction` |"
    assert row in made.partition("keys of bodies.x -->")[2].partition("end of keys")[0]


def test_no_part_of_a_machine_is_left_out() -> None:
    """Each table of the model of a machine is in the reference."""

    def tables(place: str, node: dict) -> set[str]:
        node = plain_node(node)
        node = plain_node(node.get("items", node))
        found = {place} if node.get("properties") and place else set()
        for key, value in node.get("properties", {}).items():
            if place or key not in reference.NOT_IN_THE_FILE:
                found |= tables(f"{place}.{key}".strip("."), value)
        inner = [*node.get("patternProperties", {}).values(), node.get("additionalProperties")]
        for entry in inner:
            if isinstance(entry, dict):
                name = "X" if place in {"axes", "cylinders"} else "x"
                found |= tables(f"{place}.{name}", entry)
        for kind, target in node.get("discriminator", {}).get("mapping", {}).items():
            found |= tables(f"{place}.{kind}", {"$ref": target})
        return found

    every = tables("", field_node(()))
    every = {re.sub(r"^(controllers\.x)\.[\w-]+\.dac$", r"\1.pd.dac", place) for place in every}
    assert every == set(reference.places(KEYS)) - {"machine"}


def test_every_provenance_is_named() -> None:
    for word in Provenance:
        assert f"`{word.value}`" in section("Numbers")


@pytest.fixture
def small_winder(tmp_path: Path) -> Path:
    """Return the example of the document as a file."""
    (block,) = re.findall(r"```toml\n(.*?)```", section("A small winder, whole"), re.DOTALL)
    file = tmp_path / "small-winder.toml"
    file.write_text(block, encoding="utf-8")
    return file


def test_the_example_is_a_machine_that_works(small_winder: Path) -> None:
    machine = load_machine(small_winder)
    assert machine.axis_names == ("A", "X")
    assert unstable_loops(machine) == []
    assert plausibility_warnings(machine) == []
    # Its scales agree: counts per rad of the motor are counts per m times 10 mm.
    counts_per_rad = machine.sensors["x"].reads["x"].si
    assert machine.axes["X"].counts.si * 0.010 == pytest.approx(counts_per_rad, rel=1e-6)
    # The notes state the acceleration at 6 A: torque over inertia.
    x, a = machine.bodies["x"].inertia.si, machine.bodies["a"].inertia.si
    assert 6 * 0.06 / x * 0.010 == pytest.approx(16.7, abs=0.05)
    assert 6 * 0.06 / a / 4 == pytest.approx(175, abs=0.5)


def test_the_overlay_of_the_example_swings_as_it_says(small_winder: Path) -> None:
    machine = load_machine(f"{small_winder}+arm")
    arm, eye = machine.links["arm"], machine.bodies["eye"]
    assert (arm.stiffness.si / eye.inertia.si) ** 0.5 / 6.283185 == pytest.approx(12.0, abs=0.01)
    # The carriage is lighter by the mass of the eye: 0.3 kg at 10 mm.
    rigid = load_machine(small_winder).bodies["x"].inertia.si
    assert rigid - machine.bodies["x"].inertia.si == pytest.approx(0.3 * 0.010**2, rel=1e-9)
    assert unstable_loops(machine) == []
