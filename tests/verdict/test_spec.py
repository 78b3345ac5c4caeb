"""Specification files: what they say, and that every mistake is named with its line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.errors import SpecError
from threadline.machine import load_machine
from threadline.verdict import load_spec

from .builders import winder

GOOD = """\
name = "mine"
lag = "40 ms"

[[criteria]]
name = "contour_error"
limit = "+-0.2 mm"
required = true

[[criteria]]
name = "tracking_error"
axis = "X"
limit = "5 mm"

[[criteria]]
name = "residual_vibration"
after = "20 ms"
"""


def read(tmp_path: Path, text: str | bytes):
    file = tmp_path / "mine.spec.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_spec(file, winder())


def named(spec, name, axis=""):
    return [c for c in spec.criteria if c.name == name and (not axis or c.axis == axis)]


@pytest.mark.parametrize("name", ["lathe-winder", "lathe-winder+physical", "lathe-winder+8A"])
def test_the_default_of_the_winder(name: str) -> None:
    machine = load_machine(name)
    spec = load_spec(None, machine)
    assert [c.limit for c in named(spec, "contour_error")] == [5e-4]
    assert [c.limit for c in named(spec, "turning_point_error")] == [5e-4] * 3
    assert [c.limit for c in named(spec, "repeatability")] == [1e-4]
    assert named(spec, "jerk", "X")[0].limit == machine.jerk_limit[1]
    assert named(spec, "velocity", "A")[0].limit == machine.velocity_limit[0]
    assert [c.axis for c in named(spec, "travel")] == ["X", "Y"]
    assert {c.limit for c in named(spec, "tracking_error")} == {None}
    assert {c.limit for c in named(spec, "path_deviation")} == {None}
    assert {c.limit for c in named(spec, "dac_saturation")} == {0.0}
    assert named(spec, "contour_error")[0].required
    assert len(spec.sha256) == 64


def test_a_file(tmp_path: Path) -> None:
    spec = read(tmp_path, GOOD)
    assert spec.name == "mine"
    assert spec.lag_s == pytest.approx(0.04)
    assert named(spec, "contour_error")[0].limit == pytest.approx(2e-4)
    assert named(spec, "contour_error")[0].required
    assert named(spec, "tracking_error", "X")[0].limit == pytest.approx(5e-3)
    assert dict(named(spec, "residual_vibration", "Y")[0].options) == {"after": 0.02}


def test_an_endless_axis_has_no_travel_to_keep_within(tmp_path: Path) -> None:
    text = GOOD + '[[criteria]]\nname = "travel"\naxis = "{}"\nlimit = "machine"\n'
    assert [c.limit for c in named(read(tmp_path, text.format("A")), "travel", "A")] == [None]
    assert [c.limit for c in named(read(tmp_path, text.format("X")), "travel", "X")] == [0.0]


@pytest.mark.parametrize("written", ["contour error", "contour-error"])
def test_a_criterion_may_be_written_as_people_say_it(tmp_path: Path, written: str) -> None:
    spec = read(tmp_path, GOOD.replace("contour_error", written))
    assert spec.criteria == read(tmp_path, GOOD).criteria


def test_hard_limits_and_reported_measures_are_always_there(tmp_path: Path) -> None:
    spec = read(tmp_path, GOOD)
    machine = winder()
    assert [c.limit for c in named(spec, "acceleration")] == machine.acceleration_limit.tolist()
    assert all(c.hard for c in named(spec, "velocity"))
    assert named(spec, "path_deviation")[0].limit is None
    assert len(named(spec, "dac_saturation")) == 3


def test_a_margin_leaves_the_machines_own_limits(tmp_path: Path) -> None:
    machine = load_machine("lathe-winder")
    whole, kept = load_spec(None, machine), load_spec(None, machine).with_margin(0.25)
    for before, after in zip(whole.criteria, kept.criteria, strict=True):
        if before.hard or before.limit is None:
            assert after == before
        else:
            assert after.limit == pytest.approx(0.75 * before.limit, abs=1e-12)
    assert {c.name for c in whole.criteria if c.hard} >= {"velocity", "travel"}


def test_a_length_given_for_a_rotary_axis_acts_at_the_tool(tmp_path: Path) -> None:
    text = 'name = "m"\n[[criteria]]\nname = "tracking_error"\nlimit = "{}"\n'
    spec = read(tmp_path, text.format("5 mm"))
    assert named(spec, "tracking_error", "X")[0].limit == pytest.approx(5e-3)
    assert named(spec, "tracking_error", "A")[0].limit == pytest.approx(0.05)  # radius 100 mm
    with pytest.raises(SpecError, match=r"mine\.spec\.toml:4.*deg"):
        read(tmp_path, text.format("5 deg"))


def test_one_axis_overrides_every_axis(tmp_path: Path) -> None:
    text = (
        'name = "m"\n[[criteria]]\nname = "turning_point_error"\naxis = "X"\nlimit = "1 mm"\n'
        '[[criteria]]\nname = "turning_point_error"\nlimit = "0.5 mm"\n'
    )
    spec = read(tmp_path, text)
    limits = {c.axis: c.limit for c in named(spec, "turning_point_error")}
    assert limits == {"X": 1e-3, "A": 5e-4, "Y": 5e-4}


@pytest.mark.parametrize(
    ("change", "line", "words"),
    [
        (('name = "contour_error"', 'name = "contour_eror"'), 5, "Did you mean 'contour_error'"),
        (('limit = "+-0.2', 'limt = "+-0.2'), 6, "Did you mean 'limit'"),
        (('lag = "40 ms"', 'lagg = "40 ms"'), 2, "Did you mean 'lag'"),
        (('"+-0.2 mm"', '"0.2 s"'), 6, "limit"),
        (('"+-0.2 mm"', '"-0.2 mm"'), 6, "negative"),
        (('"+-0.2 mm"', "0.2"), 6, 'has no unit.*limit = "0.2 mm"'),
        (('"+-0.2 mm"', '"0.8"'), 6, 'has no unit.*limit = "0.8 mm"'),
        (('"+-0.2 mm"', '"1e400 mm"'), 6, "finite"),
        (('"+-0.2 mm"', '"machine"'), 6, "machine has no limit"),
        (('"+-0.2 mm"', '["0.2 mm"]'), 6, "no unit"),
        (("required = true", 'required = "yes"'), 7, "true or false"),
        (('axis = "X"', 'axis = "Q"'), 11, "A, X, Y"),
        (('axis = "X"', 'axis = ["X"]'), 11, "A, X, Y"),
        (("required = true", 'axis = "X"'), 7, "at the tool"),
        (("residual_vibration", "tracking_error"), 16, "Did you mean|Known"),
        (('after = "20 ms"', 'band = "20 ms"'), 16, "Known|Did you mean"),
        (('name = "residual_vibration"\nafter = "20 ms"', 'limit = "1 mm"'), 14, "no name"),
        (('"residual_vibration"\nafter = "20 ms"', '"contour_error"'), 15, "twice"),
        (('lag = "40 ms"', "lag = 40 ms"), 2, "TOML"),
        (('name = "mine"\n', ""), 0, "name must be"),
    ],
)
def test_every_mistake_is_named_with_its_line(tmp_path: Path, change, line, words) -> None:
    assert change[0] in GOOD
    with pytest.raises(SpecError, match=words) as caught:
        read(tmp_path, GOOD.replace(*change, 1))
    assert caught.value.place is not None
    assert caught.value.place.line == line
    assert "\n" not in str(caught.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="cannot read"):
        load_spec(tmp_path / "absent.toml", winder())
    with pytest.raises(SpecError, match="cannot read"):
        load_spec(tmp_path, winder())
    with pytest.raises(SpecError, match="UTF-8"):
        read(tmp_path, b"name = '\xff\xfe'")
    with pytest.raises(SpecError, match="no criteria"):
        read(tmp_path, 'name = "m"')
    with pytest.raises(SpecError, match="no criteria"):
        read(tmp_path, 'name = "m"\ncriteria = [1]')
    with pytest.raises(SpecError, match="bytes"):
        read(tmp_path, "#" * 1_000_001)
    with pytest.raises(SpecError, match="no default"):
        load_spec(None, replace(winder(), name="mine", reference=""))
    with pytest.raises(SpecError, match="no default"):
        load_spec(None, replace(winder(), name="../lathe-winder", reference=""))


def test_the_default_of_a_machine_file_lies_beside_it(tmp_path: Path) -> None:
    machine_file = tmp_path / "mine.toml"
    machine_file.write_text('base = "lathe-winder"\n')
    machine = load_machine(machine_file)
    assert load_spec(None, machine).name == "lathe-winder"
    (tmp_path / "mine.spec.toml").write_text(GOOD)
    assert load_spec(None, machine).name == "mine"


@given(st.text(max_size=200) | st.binary(max_size=200))
def test_no_text_makes_a_traceback(content) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "s.toml"
        file.write_bytes(
            content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass")
        )
        with pytest.raises(SpecError):
            load_spec(file, winder())


def test_a_lag_beyond_any_machine_is_refused(tmp_path: Path) -> None:
    """As samples it would be more than an array can count."""
    path = tmp_path / "spec.toml"
    path.write_text('name = "a"\nlag = "1e300 s"\n[[criteria]]\nname = "contour_error"\n')
    with pytest.raises(SpecError, match="lag = '1e300 s' is above 3600 s") as caught:
        load_spec(path, load_machine("lathe-winder"))
    assert "spec.toml:2" in str(caught.value)


def test_a_machine_based_on_another_is_asked_for_the_same() -> None:
    """Two steps from the stitcher; its own demands follow from its own limits."""
    spec = load_spec(None, load_machine("stitcher-rigid-half-mass"))
    assert spec.name == "stitcher"
    assert next(c.limit for c in spec.criteria if c.name == "stitch_length_error") == 0.05
