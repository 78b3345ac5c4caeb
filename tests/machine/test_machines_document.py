"""The document on machine files and the model of a machine say the same."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from threadline.dynamics.analysis import unstable_loops
from threadline.dynamics.suspicions import suspicions
from threadline.machine import load_machine
from threadline.machine.numbers import field_node, plain_node
from threadline.machine.quantity import Provenance

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "machines.md"
TEXT = DOCUMENT.read_text(encoding="utf-8")
OURS = {"sha256", "file", "reference", "parameters"}
CONTROLLERS = tuple(field_node(("controllers", "x"))["discriminator"]["mapping"])

PARTS = {
    "Top of the file": ("",),
    "`[bodies.NAME]`": ("bodies.x",),
    "`[links.NAME]`": ("links.x",),
    "`eccentric` of a link": ("links.x.eccentric",),
    "`[drives.NAME]`, motor with a loop": ("drives.x.dc-motor",),
    "`[drives.NAME]`, stepper": ("drives.x.stepper",),
    "`winding` of a stepper": ("drives.x.stepper.winding",),
    "`[drives.NAME]`, pulse servo": ("drives.x.pulse-servo",),
    "`[drives.NAME]`, kinematic": ("drives.x.kinematic",),
    "`amplifier` of a drive": ("drives.x.dc-motor.amplifier",),
    "`[sensors.NAME]`": ("sensors.x.encoder",),
    "`[sensors.NAME]`, potentiometer": ("sensors.x.potentiometer",),
    "`[controllers.NAME]`": tuple(f"controllers.x.{kind}" for kind in CONTROLLERS),
    "`dac` of a controller": ("controllers.x.pd.dac",),
    "`[axes.X]`": ("axes.X",),
    "`profile` of an axis": ("axes.X.profile",),
    "`[path]`": ("path",),
    "`[inputs.NAME]`": ("inputs.x",),
    "`[tool]`": ("tool",),
    "`turn` to `roll` of an eye": tuple(
        f"tool.{part}" for part in ("turn", "along", "across", "up", "yaw", "roll")
    ),
    "`payout` of an eye": ("tool.payout",),
    "`roller` of an eye": ("tool.roller",),
    "`arm` of an eye": ("tool.arm",),
    "`chuck` and `tailstock` of an eye": ("tool.chuck", "tool.tailstock"),
    "`[tolerances]`": ("tolerances",),
    "`[guide]`": ("guide",),
    "`[guide.connectors.NAME]`": ("guide.connectors.x",),
    "`[programs]`": ("programs",),
    "`[planner]`, grbl and FluidNC": ("planner.grbl",),
    "`[planner]`, Marlin": ("planner.marlin",),
    "`[planner]`, Klipper": ("planner.klipper",),
    "`[planner]`, RepRapFirmware": ("planner.reprapfirmware",),
    "`[planner]`, LinuxCNC": ("planner.linuxcnc",),
    "`[operator]`": ("operator",),
    "`[cylinders.X]`": ("cylinders.X",),
    "`forward` and `back` of a cylinder": ("cylinders.X.forward", "cylinders.X.back"),
    "`cushion` of a cylinder": ("cylinders.X.cushion",),
    "`[outputs]`": ("outputs.x",),
    "`[contacts]`": ("contacts.x",),
    "`[plc]`": ("plc",),
    "`[shaft]`": ("shaft",),
    "`[tables]`": ("tables",),
    "`[design]`: its tables": ("design",),
    "`[design.parameters.NAME]`": ("design.parameters.x",),
    "`[design.settings]`": ("design.settings",),
    "`[design.known.NAME]`": ("design.known.x",),
}


def sections() -> dict[str, str]:
    """Return the text under each heading of the third level."""
    parts = re.split(r"^#{2,3} (.+)$", TEXT, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def rows(heading: str) -> dict[str, list[str]]:
    """Return the rows of the tables of a section that have four columns, by their key."""
    found = {}
    for line in sections()[heading].splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| `") and len(cells) == 4:
            found[cells[0].strip("`")] = cells
    return found


def model(heading: str) -> tuple[dict[str, dict], set[str]]:
    """Return the keys of a part with what may stand there, and those that must be there."""
    keys: dict[str, dict] = {}
    required: set[str] = set()
    for place in PARTS[heading]:
        node = field_node(tuple(place.split(".")) if place else ())
        keys |= {k: v for k, v in node["properties"].items() if place or k not in OURS}
        required |= set(node.get("required", []))
    return keys, required


def units_of(node: dict) -> list[str]:
    """Return the units of a key, or of what its table or list holds."""
    node = plain_node(node)
    if "x-units" in node:
        return node["x-units"]
    inner = [*node.get("patternProperties", {}).values(), node.get("additionalProperties")]
    inner += [node.get("items"), *node.get("prefixItems", [])]
    return [unit for entry in inner if isinstance(entry, dict) for unit in units_of(entry)]


@pytest.mark.parametrize("heading", PARTS)
def test_every_key_has_its_row(heading: str) -> None:
    keys, required = model(heading)
    written = rows(heading)
    assert set(written) == set(keys)
    for key, cells in written.items():
        assert cells[1]
        assert (cells[3] == "required") == (key in required), key
        for unit in units_of(keys[key]):
            assert (unit or "plain number") in cells[2].split(", "), key


def test_no_part_of_a_machine_is_left_out() -> None:
    """Each table that the model of a machine has is one of those above."""
    described = {place for places in PARTS.values() for place in places}

    def tables(place: str, node: dict) -> set[str]:
        node = plain_node(node)
        found = {place} if node.get("properties") and place else set()
        for key, value in node.get("properties", {}).items():
            if place or key not in OURS:
                found |= tables(f"{place}.{key}".strip("."), value)
        inner = [*node.get("patternProperties", {}).values(), node.get("additionalProperties")]
        for entry in inner:
            if isinstance(entry, dict):
                name = "X" if place in {"axes", "cylinders"} else "x"
                found |= tables(f"{place}.{name}", entry)
        for kind, reference in node.get("discriminator", {}).get("mapping", {}).items():
            found |= tables(f"{place}.{kind}", {"$ref": reference})
        return found

    every = tables("", field_node(()))
    every = {re.sub(r"^(controllers\.x)\.[\w-]+\.dac$", r"\1.pd.dac", place) for place in every}
    assert every == described - {""}


def test_every_choice_and_provenance_is_named() -> None:
    for heading in PARTS:
        for key, node in model(heading)[0].items():
            plain = plain_node(node)
            for choice in plain.get("enum", [plain["const"]] if "const" in plain else []):
                assert f"`{choice}`" in sections()[heading], (heading, key)
    for word in Provenance:
        assert f"`{word.value}`" in sections()["Numbers"]


@pytest.fixture
def small_winder(tmp_path: Path) -> Path:
    """The example of the document as a file."""
    (block,) = re.findall(r"```toml\n(.*?)```", sections()["A small winder, whole"], re.DOTALL)
    file = tmp_path / "small-winder.toml"
    file.write_text(block, encoding="utf-8")
    return file


def test_the_example_is_a_machine_that_works(small_winder: Path) -> None:
    machine = load_machine(small_winder)
    assert machine.axis_names == ("A", "X")
    assert unstable_loops(machine) == []
    assert suspicions(machine) == []
    # Its scales agree: counts per rad of the motor are counts per m times 10 mm.
    counts_per_rad = machine.sensors["x"].reads["x"].si
    assert machine.axes["X"].counts.si * 0.010 == pytest.approx(counts_per_rad, rel=1e-6)
    # What the notes say that 6 A give, by torque over inertia.
    x, a = machine.bodies["x"].inertia.si, machine.bodies["a"].inertia.si
    assert 6 * 0.06 / x * 0.010 == pytest.approx(16.7, abs=0.05)
    assert 6 * 0.06 / a / 4 == pytest.approx(175, abs=0.5)


def test_the_overlay_of_the_example_swings_as_it_says(small_winder: Path) -> None:
    machine = load_machine(f"{small_winder}+arm")
    arm, eye = machine.links["arm"], machine.bodies["eye"]
    assert (arm.stiffness.si / eye.inertia.si) ** 0.5 / 6.283185 == pytest.approx(12.0, abs=0.01)
    # The carriage lost what the eye took: 0.3 kg at 10 mm.
    rigid = load_machine(small_winder).bodies["x"].inertia.si
    assert rigid - machine.bodies["x"].inertia.si == pytest.approx(0.3 * 0.010**2, rel=1e-9)
    assert unstable_loops(machine) == []
