"""Specification files: their content, and the line of every mistake."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.errors import SpecError
from threadline.files import ChannelKind
from threadline.machine import load_machine
from threadline.search.design import spec_toml
from threadline.verdict import Status, is_assumed, judge, load_spec
from threadline.verdict.registry import MEASURES

from .builders import follow, plan_through, record, winder

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


def test_specification_file_is_read(tmp_path: Path) -> None:
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
        (('after = "20 ms"', 'window = "0 s"'), 16, "measures nothing. Give a longer window"),
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
    for name in ("mine", "../lathe-winder"):  # no name leads out of the library
        assert is_assumed(load_spec(None, replace(winder(), name=name, reference="")))


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
    """In samples the lag would be more than an array can count."""
    path = tmp_path / "spec.toml"
    path.write_text('name = "a"\nlag = "1e300 s"\n[[criteria]]\nname = "contour_error"\n')
    with pytest.raises(SpecError, match="lag = '1e300 s' is above 3600 s") as caught:
        load_spec(path, load_machine("lathe-winder"))
    assert "spec.toml:2" in str(caught.value)


def test_a_machine_based_on_another_is_asked_for_the_same() -> None:
    """It is based on the stitcher in two steps; its hard limits follow from its own limits."""
    spec = load_spec(None, load_machine("stitcher-rigid-half-mass"))
    assert spec.name == "stitcher"
    assert next(c.limit for c in spec.criteria if c.name == "stitch_length_error") == 0.05


def of(spec, name):
    """Return (axis, limit, hard) of every criterion of a measure."""
    return {(c.axis, c.limit, c.hard) for c in named(spec, name)}


NAMED = 'name = "m"\n[[criteria]]\nname = "velocity"\naxis = "Y"\n'


@pytest.mark.parametrize(
    ("written", "of_y"),
    [
        ("", {("Y", "own", True)}),  # the file only reports it; the machine's limit still holds
        ('limit = "100 mm/s"', {("Y", 0.1, False)}),
        ('limit = "1200 mm/s"', {("Y", 1.2, False), ("Y", "own", True)}),
        ('limit = "machine"', {("Y", "own", True)}),
    ],
)
def test_naming_one_axis_leaves_the_machines_limits_of_all(tmp_path: Path, written, of_y) -> None:
    spec, machine = read(tmp_path, f"{NAMED}{written}\n"), winder()
    own = dict(zip(machine.axis_names, machine.velocity_limit.tolist(), strict=True))
    expected = {(a, own[a] if limit == "own" else limit, hard) for a, limit, hard in of_y}
    expected |= {(a, own[a], True) for a in ("A", "X")}
    assert of(spec, "velocity") == expected
    assert {c.axis for c in named(spec, "jerk") if c.hard} == {"A", "X", "Y"}
    notes = [c.note for c in named(spec, "velocity") if c.note]
    assert bool(notes) is ("1200" in written)


def test_a_wider_limit_than_the_machines_fails_with_the_machines_own(tmp_path: Path) -> None:
    """X reaches 1.286 of the machine's 1 m/s; the file names Y, or allows more."""
    machine = winder()
    assert machine.velocity_limit.tolist()[1] == 1.0
    points = [[0.0, 0.0], [0.1286, 0.01]]
    commanded, operation = follow(points, 20)
    recording = record(("X", "Y"), {ChannelKind.LOAD: commanded}, operation)
    for text in (f'{NAMED}limit = "1 m/s"\n', NAMED.replace('"Y"', '"X"') + 'limit = "2 m/s"\n'):
        verdict = judge([recording], plan_through(points, ("X", "Y")), read(tmp_path, text))
        failed = [r for r in verdict.results if r.name == "velocity" and r.axis == "X"]
        assert max(r.severity for r in failed)[0] == 3
        assert verdict.result("velocity", "X").limit == 1.0
        assert verdict.result("velocity", "X").status is Status.FAILED
        wide = [
            r for r in failed if (r.limit or 0.0) > 1.0
        ]  # 2.2: a recording may exceed 2 by 10 %
        assert all(r.status is Status.PASSED for r in wide)
        assert ("cannot widen" in verdict.result("velocity", "X").note) is bool(wide)


def test_naming_one_axis_keeps_what_is_always_listed_of_the_others(tmp_path: Path) -> None:
    text = 'name = "m"\n[[criteria]]\nname = "dac_saturation"\naxis = "Y"\nlimit = "1 %"\n'
    spec = read(tmp_path, text)
    assert of(spec, "dac_saturation") == {
        ("Y", 0.01, False),
        ("A", None, False),
        ("X", None, False),
    }


def test_a_wider_limit_of_a_valve_holds_beside_the_machines(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text('name = "s"\n[[criteria]]\nname = "switching_dwell"\nlimit = "50 ms"\n')
    spec = load_spec(file, load_machine("letter-placer"))
    assert of(spec, "switching_dwell") == {("", 0.05, False), ("", 0.0, True)}
    assert {c.limit for c in named(spec, "valve_conflict")} == {0.0}


SHARE = 'name = "m"\n[[criteria]]\nname = "{}"\nlimit = {}\n'
SHARES = sorted(n for n, k in MEASURES.items() if k.dimension == "ratio")


@pytest.mark.parametrize("name", SHARES)
def test_a_share_needs_its_unit_or_is_no_more_than_the_whole(tmp_path: Path, name: str) -> None:
    for written, value in [('"5 %"', 0.05), ("0.05", 0.05), ('"0.05"', 0.05), ("1", 1.0)]:
        assert named(read(tmp_path, SHARE.format(name, written)), name)[0].limit == value
    assert named(read(tmp_path, SHARE.format(name, '"150 %"')), name)[0].limit == 1.5
    for written in ("5", '"5"', "1.0001", '"+-5"'):
        with pytest.raises(SpecError, match=rf"mine\.spec\.toml:4.*{name} is a share.* %"):
            read(tmp_path, SHARE.format(name, written))
    for written in ('"5 mm"', "true", '""', "nan", "inf", "-0.1"):
        with pytest.raises(SpecError, match=r"mine\.spec\.toml:4"):
            read(tmp_path, SHARE.format(name, written))


def test_number_of_recordings_must_be_whole(tmp_path: Path) -> None:
    text = SHARE.format("repeatability", '"1 mm"') + "recordings = {}\n"
    assert dict(named(read(tmp_path, text.format(5)), "repeatability")[0].options) == {
        "recordings": 5.0
    }
    for written in ("1", "2.5", '"20 %"', "true", "-3", "0.05"):
        with pytest.raises(SpecError, match=r"mine\.spec\.toml:5.*whole number of at least 2"):
            read(tmp_path, text.format(written))


def test_a_specification_written_beside_a_design_reads_the_same(tmp_path: Path) -> None:
    """It has a limit wider than the machine's, a share above 100 %, and a count."""
    text = (
        f'{NAMED}limit = "1200 mm/s"\n'
        + '[[criteria]]\nname = "repeatability"\nlimit = "1 mm"\nrecordings = 5\n'
        + '[[criteria]]\nname = "velocity_ripple"\nlimit = "150 %"\nover = "10 ms"\n'
        + '[[criteria]]\nname = "dac_saturation"\nlimit = "0.1 %"\nrequired = true\n'
    )
    spec = read(tmp_path, text)
    again = read(tmp_path, spec_toml(spec, winder()))

    def every(criteria):
        return {(c.name, c.axis, c.limit, c.hard, c.required, *c.options.items()) for c in criteria}

    assert every(again.criteria) == every(spec.criteria)
    assert len(again.criteria) == len(spec.criteria)


@pytest.mark.parametrize(
    ("library", "place"),
    [("lathe-winder", True), ("letter-placer", False), ("table-embroiderer", False)],
)
def test_a_machine_without_a_specification_gets_one_that_says_so(
    tmp_path: Path, library: str, place: bool
) -> None:
    """A copy of a library's file with another name: its limits, and a contour error with axes."""
    text = (resources.files("threadline.machine") / "library" / f"{library}.toml").read_text(
        "utf-8"
    )
    (tmp_path / "own.toml").write_text(re.sub(r"(?m)^name = .*", 'name = "own"', text, count=1))
    spec = load_spec(None, load_machine(tmp_path / "own.toml"))
    assert is_assumed(spec) and "no specification" in spec.name
    asked = [one for one in spec.criteria if one.name == "contour_error" and one.limit == 0.5e-3]
    assert bool(asked) == place
    assert not is_assumed(load_spec(None, load_machine(library)))
