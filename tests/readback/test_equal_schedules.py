"""``equal`` for programs of a PLC: parsed by their grammar, run scan by scan, and changed."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

import threadline as tl
from tests.commands.plc.driving import Bench
from tests.commands.plc.machine import Plc
from tests.commands.plc.texts import units_of
from threadline.errors import InputError
from threadline.readback.equal import Equal
from threadline.readback.equal_schedule import Controller
from threadline.readback.scan_language import read_body, read_units
from threadline.readback.scan_words import ScanError, time_us
from threadline.report.differences import difference_figure

PLACER = "letter-placer"
TARGETS = ("st", "openplc", "plcopen", "scl")
SCAN_S = 0.01


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the files of all targets, as compile writes them."""
    made = tmp_path_factory.mktemp("programs")
    for target in TARGETS:
        tl.compile(CYCLE, PLACER, target, made / f"cycle-{target}.{target}")
    return made


CYCLE = Path(__file__).resolve().parents[2] / "examples" / "letter-cycle.toml"


def changed(folder: Path, tmp_path: Path, target: str, pattern: str, to: str) -> Path:
    """Return a changed copy of a file, with the files beside it; the first match is replaced."""
    for file in folder.glob(f"cycle-{target}.*"):
        shutil.copy(file, tmp_path / file.name)
    copy = tmp_path / f"cycle-{target}.{target}"
    text = copy.read_text()
    other = re.sub(pattern, to, text, count=1)
    assert other != text
    copy.write_text(other)
    return copy


def beside(target: str, file: Path) -> Equal:
    return tl.equal(CYCLE, PLACER, files=[f"{target}={file}"]).targets[0]


@pytest.mark.parametrize("job", ["letter-cycle", "swivel-cycle"])
def test_every_program_switches_as_the_schedule_does(examples: Path, job: str) -> None:
    """Each of the four files, read and run by itself, to the scan."""
    machine = PLACER if job == "letter-cycle" else examples / "swivel.toml"
    found = tl.equal(examples / f"{job}.toml", machine)
    assert {one.target for one in found.targets} == set(TARGETS)
    for one in found.targets:
        assert (one.verdict, one.place, one.time_s) == ("equal", 0.0, 0.0)
        assert one.time_limit_s == pytest.approx(SCAN_S)
        assert one.place_limit and one.curve is not None and len(one.curve.time_s) > 30


# The time of a stroke: of Z in IEC's text and in SCL, as XML has it.
@pytest.mark.parametrize(
    ("target", "pattern"),
    [
        ("st", r"(t_descend_2 : TIME := T#)(\d)(\d+ms)"),
        ("openplc", r"(t_descend_2 : TIME := T#)(\d)(\d+ms)"),
        ("scl", r"(t_descend_2 : Time := T#)(\d)(\d+ms)"),
        ("plcopen", r'(name="t_descend_2">.*?simpleValue value="T#)(\d)(\d+ms)'),
    ],
)
def test_a_digit_of_a_time_is_found(
    folder: Path, tmp_path: Path, target: str, pattern: str
) -> None:
    """100 ms more of rest below: every later output is ten scans late, Z by 20 mm at 0.2 m/s."""

    def more(found: re.Match[str]) -> str:
        return f"{found[1]}{int(found[2]) + 1}{found[3]}"

    file = changed(folder, tmp_path, target, f"(?s){pattern}", "@@@")
    text = (folder / file.name).read_text()
    file.write_text(re.sub(f"(?s){pattern}", more, text, count=1))
    one = beside(target, file)
    assert one.verdict == "differs"
    assert one.time_s == pytest.approx(10 * SCAN_S)
    assert one.axis == "Z" and one.place == pytest.approx(0.02, rel=1e-6)
    assert one.place_limit == pytest.approx(0.002)
    assert one.at == "venturi at scan 237"
    assert "compile writes" in one.note


def test_an_output_that_is_not_switched_and_a_program_that_stops(
    folder: Path, tmp_path: Path
) -> None:
    """The knife is named; a condition that is never true ends the run in a fault."""
    knife = changed(folder, tmp_path, "st", r"  knife := TRUE;", "  knife := FALSE;")
    assert "knife: 0 switchings, the plan has 2" in beside("st", knife).note
    endless = changed(folder, tmp_path, "st", r"busy := place <> idle;", "WHILE TRUE DO END_WHILE;")
    one = beside("st", endless)
    assert one.verdict == "differs" and "its loop never ends" in one.note
    slow = changed(folder, tmp_path, "openplc", r"INTERVAL := T#10ms", "INTERVAL := T#20ms")
    assert "its task runs every 20 ms, the plan has 10 ms" in beside("openplc", slow).note


def test_foreign_programs_are_refused_in_one_line(folder: Path, tmp_path: Path) -> None:
    """Another job, machine file, version or format; cut, empty, binary, a folder; no address."""
    bad = tmp_path / "bad.st"
    text = (folder / "cycle-st.st").read_text()
    for content, message in [
        (re.sub(r"(Job \S+, sha256 )\w{4}", r"\g<1>0000", text), "another job: it names 0000"),
        (re.sub(r"(Machine \S+, sha256 )\w{4}", r"\g<1>0000", text), "another machine file"),
        (text.replace("Threadline 0", "Threadline 9"), "another version of Threadline"),
        (text[: len(text) // 2], "cut off"),
        ("", "is empty"),
        ("\x00\x01", "is no program of target st"),
        (text.replace("%QX0.1", "%QX7.7"), "%QX0.1 of x_right"),
        ("<project/>", "is no program of target st"),
    ]:
        bad.write_text(content)
        with pytest.raises(InputError, match=re.escape(message)) as refused:
            beside("st", bad)
        assert "\n" not in str(refused.value)
    bad.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="no program of target st"):
        beside("st", bad)
    with pytest.raises(InputError, match="there is no file"):
        beside("st", tmp_path)
    for content in ("<!DOCTYPE x><project/>", "<project>", "x"):
        bad.write_text(content)
        with pytest.raises(InputError, match="no program of target plcopen"):
            beside("plcopen", bad)
    shutil.copy(folder / "cycle-scl.scl", tmp_path / "alone.scl")
    with pytest.raises(InputError, match=re.escape("the table of its tags is missing")):
        beside("scl", tmp_path / "alone.scl")


def test_our_controller_runs_a_text_as_blarks_reading_does(folder: Path) -> None:
    """Two independent readers: home and a cycle with jitter, scan by scan."""
    units = units_of(PLACER, "none")
    other = Controller(list(read_units((folder / "cycle-st.st").read_text())))
    bench = Bench(Plc(units), jitter=0.2, seed=3)
    seen = 0

    def scan(**given: bool) -> None:
        nonlocal seen
        bench.scan(**given)
        inputs = {name: bench.plc.instance.v[name] for name in (*bench.plc.inputs, *bench.plc.panel)
                  if name in asked}  # fmt: skip
        state = other.scan(inputs, bench.now)
        on = {name for name, at in located.items() if state(at)}
        assert on == bench.on
        seen += len(on)

    program = bench.plc.program.declared
    located = {name: program[name].address.upper() for name in bench.plc.outputs}
    asked = {*bench.plc.inputs, "continuous", "stop_at_end", "manual", "jog"}
    for button in ("home_button", "start_button"):
        scan()
        scan(**{button: True})
        for _ in range(3000):
            if not bench.block["busy"]:
                break
            scan()
    assert bench.block["finished"] and seen > 1000


def test_the_language() -> None:
    """Precedence, durations, and refusals with their line."""
    values = {"a": 2, "b": 3, "c": 0, "t": True}
    read_body("c := a + b * 2 MOD 4; t := NOT t OR a < b AND b <> 3;")(values, 0)
    assert values["c"] == 2 + 3 * 2 % 4 and values["t"] is False
    assert time_us("T#1s500ms") == 1_500_000 and time_us("TIME#2m") == 120_000_000
    for text, message in [("a := ;", "constant"), ("a = 1;", ":="), ("?", "no word"),
                       ("a := " + "(" * 90 + "1;", "deep"), ("FOR i", ":=")]:  # fmt: skip
        with pytest.raises(ScanError, match=message):
            read_body(text)
    with pytest.raises(ScanError) as refused:
        list(read_units("PROGRAM p\nVAR\n  x : BOOL;\n  x : BOOL;\nEND_VAR\nEND_PROGRAM"))
    assert refused.value.line == 4


def test_a_figure_without_a_curve_of_the_place_gives_the_largest_difference() -> None:
    """A program of a PLC has one difference in place for the whole job, with its limit."""
    found = tl.equal(CYCLE, PLACER, targets=["st"]).targets
    place, time = difference_figure(found).axes
    (text,) = [one.get_text() for one in place.texts]
    assert "0 um, limit 4.3 mm" in text and time.lines
