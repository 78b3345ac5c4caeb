"""Machine files with missing links or keys, and files that are no machine files."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.machine.machine_text import WINDER, edit, line_of
from threadline.errors import MachineError
from threadline.machine import load_machine

REFERENCES = {
    "body of a drive": ("acts_on = { x =", "acts_on = { xx =", "drives.x.acts_on", "'xx'"),
    "body of a sensor": ("reads = { x =", "reads = { q =", "sensors.x.reads", "'q'"),
    "clock": ('clock = "servo"', 'clock = "sevro"', "controllers.x.clock", "'sevro'"),
    "sensor": ('sensor = "x"', 'sensor = "z"', "controllers.x.sensor", "'z'"),
    "drive": ('drive = "x"', 'drive = "z"', "controllers.x.drive", "'z'"),
    "controller": ('controller = "a"', 'controller = "b"', "axes.A.controller", "'b'"),
    "axis": ('axis = "X"', 'axis = "Z"', "inputs.x_low.axis", "'Z'"),
    "drive to cut": ('cuts = "x"', 'cuts = "xy"', "inputs.x_low.cuts", "'xy'"),
}


@pytest.mark.parametrize("name", REFERENCES)
def test_links_to_nothing_are_told_with_their_line(refused, name) -> None:
    old, new, where, what = REFERENCES[name]
    text = edit(old, new)
    message = refused(text)
    assert f"{where} names the " in message
    assert f"{what}, which does not exist" in message
    first = next(n for n, line in enumerate(text.splitlines(), 1) if new in line)
    assert f"mine.toml:{first}: " in message
    if name == "clock":
        assert "did you mean 'servo'?" in message


def test_a_link_to_no_body(refused) -> None:
    text = WINDER + (
        "\n[links.belt]\n"
        'stretch = { x = "1 exact, assumed", yy = "-1 exact, assumed" }\n'
        'stiffness = "1 N m/rad exact, assumed"\n'
    )
    message = refused(text)
    assert "links.belt.stretch names the body 'yy', which does not exist" in message
    assert f"mine.toml:{line_of(text, 'yy = ')}: " in message


@pytest.mark.parametrize(
    ("key", "value", "unit"),
    [
        ("damping", "1 N s/m", "N*m*s/rad"),
        ("preload", "1 N", "N*m"),
        ("play", "1 mm", "rad"),
        ("play", "1 rad", ""),
    ],
)
def test_the_numbers_of_a_link_are_of_one_kind(refused, key, value, unit) -> None:
    """A play of 1 mm on a torsion spring would be taken for 0.001 rad."""
    text = WINDER + (
        "\n[links.belt]\n"
        'stretch = { x = "1 exact, assumed" }\n'
        'stiffness = "1 N m/rad exact, assumed"\n'
        f'{key} = "{value} exact, assumed"\n'
    )
    if not unit:
        text += (
            '[links.belt.eccentric]\nangle = { x = "1 exact, assumed" }\n'
            'width = "1 mm exact, assumed"\nphase = "0 rad exact, assumed"\n'
        )
        key, unit = "eccentric.width", "rad"
    message = refused(text)
    assert f"{key} is in " in message
    assert f"with a stiffness in N*m/rad it must be in {unit}" in message


def test_missing_key_is_named_with_its_table(refused) -> None:
    text = edit('resistance = "0.4 ohm +- 10 %, printed: motor S19-1A"\n', "")
    message = refused(text)
    assert "'drives.x.resistance' is missing" in message
    assert f"mine.toml:{line_of(text, '[drives.x]')}: " in message
    begin, end = WINDER.index("[tool]"), WINDER.index("[operator]")
    assert "'tool' is missing" in refused(WINDER[:begin] + WINDER[end:])


def test_stiction_needs_a_friction(refused) -> None:
    text = edit("[bodies.x]\n", '[bodies.x]\nstiction = "1 N m exact, assumed"\n')
    assert "stiction must come with a friction that is not larger" in refused(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "keys are missing"),
        ("name = ", "not valid TOML"),
        ("a = 1\na = 2\n", "not valid TOML"),
        ("\0\0", "not valid TOML"),
        (b"\xff\xfe", "not UTF-8"),
        ("x" * 1_000_001, "1000001 bytes, limit 1000000"),
        ("base = 5\n", "mine.toml:1: base must be the name of a machine"),
        ('base = "mine.toml"\n', "in a circle"),
        (
            'base = "lathe-winder+phys"\n',
            "'lathe-winder' has no overlay 'phys'. Did you mean",
        ),
        ('base = "nothing.toml"\n', "cannot read"),
        ('base = "lathe-winder"\noverlays = 3\n', "overlays must be tables"),
        ("[overlays]\nheavy = 3\n", "overlays must be tables"),
        ('base = "lathe-winder"\n\nsha256 = "00"\n', "mine.toml:3: unknown key 'sha256'"),
        ('base = "lathe-winder"\nfile = "a"\n', "mine.toml:2: unknown key 'file'"),
        ("a = " + "[" * 5000, "nested too deeply"),
        ("a" + ".a" * 5000 + " = 1", "nested too deeply"),
        ("[bodies]\nx = 3\n" + WINDER.replace("[bodies.x]", "[bodies.w]"), "bodies"),
    ],
)
def test_files_that_are_none(refused, text, message) -> None:
    assert message in refused(text)


def test_lines_of_toml_errors(refused) -> None:
    assert "mine.toml:2: not valid TOML" in refused('name = "a"\nb = = 3\n')


def test_a_folder_is_no_machine(tmp_path) -> None:
    (tmp_path / "a.toml").mkdir()
    with pytest.raises(MachineError, match="cannot read"):
        load_machine(tmp_path / "a.toml")


def test_a_name_with_a_plus_in_its_path_is_read(tmp_path) -> None:
    folder = tmp_path / "c++"
    folder.mkdir()
    path = Path(folder / "mine.toml")
    path.write_text(WINDER, encoding="utf-8")
    assert load_machine(path).name == "lathe-winder"
    assert load_machine(f"{path}+physical").name == "lathe-winder+physical"


def test_a_circle_through_folders_is_noticed(tmp_path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "m.toml").write_text('base = "../a/m.toml"\n')
    with pytest.raises(MachineError, match="in a circle"):
        load_machine(tmp_path / "a" / "m.toml")


def test_an_error_in_an_overlay_has_its_line(tmp_path) -> None:
    """It is the line of the last overlay that sets it, or of the file if no overlay does."""
    path = tmp_path / "mine.toml"

    def refusal(text: str, overlays: str) -> str:
        path.write_text(text, encoding="utf-8")
        with pytest.raises(MachineError) as caught:
            load_machine(f"{path}+{overlays}")
        return str(caught.value)

    text = edit('x_eye = "-1 exact', 'xq = "-1 exact')
    message = refusal(text, "springy")
    assert f"mine.toml:{line_of(text, 'xq =')}: links.x_arm.stretch names the body 'xq'" in message
    text = edit('stiffness = "1.705 kN/m +- 20 %', 'stiffness = "1.705 kN +- 20 %')
    message = refusal(text, "springy+8A")
    assert f"mine.toml:{line_of(text, '1.705 kN +-')}: links.x_arm.stiffness: " in message
    text = edit("[overlays.springy.bodies.x]\n", '[overlays.springy.bodies.x]\nkinf = "linear"\n')
    message = refusal(text, "physical+springy")
    assert f"mine.toml:{line_of(text, 'kinf')}: unknown key 'bodies.x.kinf'" in message
    text = edit('servo = "5 ms', 'servo = "0 ms')
    assert f"mine.toml:{line_of(text, '0 ms exact, printed: section')}: " in refusal(
        text, "springy"
    )


def test_an_unknown_table_is_found_by_the_header_of_a_table_in_it(refused) -> None:
    text = edit("[tool]", "[link.feet]\n[tool]")
    message = refused(text)
    assert f"mine.toml:{line_of(text, '[link.feet]')}: unknown key 'link'" in message
