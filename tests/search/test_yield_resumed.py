"""An interrupted yield goes on to the same bits, or its file is refused."""

from __future__ import annotations

import gc
import json
import os
import random
import re
import resource
import socket
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.live.kill_bench import child
from tests.search.plans import JOB
from threadline.cli.main import main
from threadline.commands.plan import Plan
from threadline.errors import OptionError, RecordingError
from threadline.search import machine_yield
from threadline.search.machine_yield import MachineYield
from threadline.search.yield_state import YieldState, content_of_runs, line_of
from threadline.verdict import Spec


def test_a_yield_that_was_broken_off_goes_on_to_the_same_bits(
    asked: tuple[Plan, Spec], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, spec = asked
    file, identity = tmp_path / "deep" / "state", {"seed": "3"}
    whole = MachineYield(plan, spec).drawn(40, 3)
    monkeypatch.setattr(machine_yield, "AT_ONCE", 16)

    def interrupted(through: int) -> None:
        if state.known is not None and state.known.runs == 16:
            raise KeyboardInterrupt

    state = YieldState(file, identity)
    with pytest.raises(KeyboardInterrupt):
        MachineYield(plan, spec, threads=1).drawn(40, 3, interrupted, state)
    again = YieldState(file, identity)
    assert again.known is not None and again.known.runs == 16 and not again.cut
    through: list[int] = []
    found = MachineYield(plan, spec).drawn(40, 3, through.append, again)
    assert through[0] == 16 and sum(through) == 40
    for own, other in zip(found.found.rows, whole.found.rows, strict=True):
        np.testing.assert_array_equal(own.values, other.values)
        np.testing.assert_array_equal(own.failed, other.failed)
        assert (own.name, own.axis, own.limit, own.unit) == (
            other.name, other.axis, other.limit, other.unit,
        )  # fmt: skip
    # Fewer machines than are known, and none of them is judged anew.
    few = MachineYield(plan, spec).drawn(10, 3, None, YieldState(file, identity))
    np.testing.assert_array_equal(few.found.passed, whole.found.passed[:10])
    # Only a line that was cut short is left out.
    content = file.read_bytes()
    file.write_bytes(content[:-9])
    cut = YieldState(file, identity)
    assert cut.cut and cut.known is not None and cut.known.runs == 32
    assert content.startswith(file.read_bytes()) and file.read_bytes().count(b"\n") == 3


def test_a_full_disk_loses_nothing_that_was_judged(
    asked: tuple[Plan, Spec], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system refuses to write on; once there is room again, the same file goes on."""
    plan, spec = asked
    file = tmp_path / "state"
    whole = MachineYield(plan, spec).drawn(40, 3)
    monkeypatch.setattr(machine_yield, "AT_ONCE", 16)
    state = YieldState(file, {"seed": "3"})
    line = len(line_of(content_of_runs(whole.found.taken(np.arange(16)), 0)))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (file.stat().st_size + line + 100, before[1]))
    try:
        with pytest.raises(OptionError, match=r"cannot write .*state': File too large") as caught:
            MachineYield(plan, spec).drawn(40, 3, None, state)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "goes on with the machines that the file holds" in (caught.value.remedy or "")
    del state, caught
    gc.collect()
    again = YieldState(file, {"seed": "3"})
    assert again.known is not None and again.known.runs >= 16
    found = MachineYield(plan, spec).drawn(40, 3, None, again)
    for own, other in zip(found.found.rows, whole.found.rows, strict=True):
        np.testing.assert_array_equal(own.values, other.values)


def summed(body: bytes) -> bytes:
    """Return a line with any content and its right check sum."""
    return b"%08x %s\n" % (zlib.crc32(body), body)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda text: b"not a state\n", RecordingError, "state:1: the state of a yield"),
        (lambda text: text.replace(b'"runs":5', b'"runs":4'), RecordingError, "state:2:"),
        (lambda text: text + summed(b"[1, 2]"), RecordingError, "state:3: the state of a"),
        (lambda text: text + summed(b"{"), RecordingError, "state:3: '{' is not JSON"),
        (lambda text: text + summed(b"\xff"), RecordingError, "state:3:"),
        (lambda text: text + text.splitlines(True)[1], RecordingError, "state:3: the state of a"),
        (lambda text: text, OptionError, "was begun with another seed"),
    ],
)
def test_a_state_that_is_damaged_or_of_another_yield_is_refused(
    asked: tuple[Plan, Spec], tmp_path: Path, change, error: type[Exception], message: str
) -> None:
    plan, spec = asked
    file = tmp_path / "state"
    MachineYield(plan, spec).drawn(5, 3, None, YieldState(file, {"seed": "3"}))
    changed = change(file.read_bytes())
    file.write_bytes(changed)
    seed = "4" if error is OptionError else "3"
    with pytest.raises(error, match=re.escape(message)):
        YieldState(file, {"seed": seed})
    assert file.read_bytes() == changed


ODD: tuple[Any, ...] = (None, True, -1, 0.5, 10**400, "", "x", [], [1], {}, {"a": 1}, float("nan"))


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path to every field of a line."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in pairs:
        yield (*at, key)
        if isinstance(inner, dict | list):
            yield from places(inner, (*at, key))


def changed(line: bytes, place: tuple[Any, ...], value: Any) -> bytes:
    """Return a line with another value at a place, and with the check sum of the new content."""
    content = json.loads(line.partition(b" ")[2])
    part = content
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    return summed(json.dumps(content, separators=(",", ":")).encode())


def test_no_changed_field_is_a_defect_or_passes_for_the_answer(
    asked: tuple[Plan, Spec], tmp_path: Path
) -> None:
    """Every field of every line is changed, with a right check sum: refused, or without effect."""
    plan, spec = asked
    judged, file = MachineYield(plan, spec), tmp_path / "state"
    whole = judged.drawn(5, 3, None, YieldState(file, {"seed": "3"}))
    judged.drawn(8, 3, None, YieldState(file, {"seed": "3"}))
    good = file.read_bytes().splitlines(True)
    drawn = random.Random(39)
    tried = 0
    for number, line in enumerate(good):
        content = json.loads(line.partition(b" ")[2])
        for place in places(content):
            for value in drawn.sample(ODD, 2):
                tried += 1
                lines = [*good]
                lines[number] = changed(line, place, value)
                file.write_bytes(b"".join(lines))
                try:
                    found = judged.drawn(5, 3, None, YieldState(file, {"seed": "3"}))
                except (OptionError, RecordingError) as error:
                    assert "\n" not in str(error)
                    continue
                for own, other in zip(found.found.rows, whole.found.rows, strict=True):
                    assert own.text == other.text, (number, place, value)
                    np.testing.assert_array_equal(own.values, other.values)
                    np.testing.assert_array_equal(own.failed, other.failed)
    assert tried > 250


@pytest.mark.parametrize("numbered", [True, False])
def test_rows_in_another_order_are_refused(
    asked: tuple[Plan, Spec], tmp_path: Path, numbered: bool
) -> None:
    """Rows were joined by their place, so that one criterion got the values of another."""
    plan, spec = asked
    judged, file = MachineYield(plan, spec), tmp_path / "state"
    judged.drawn(5, 3, None, YieldState(file, {"seed": "3"}))
    head, line = file.read_bytes().splitlines(True)
    rows = json.loads(line.partition(b" ")[2])["rows"][::-1]
    if numbered:
        rows = [{**row, "number": k} for k, row in enumerate(rows)]
    file.write_bytes(head + changed(line, ("rows",), rows))
    with pytest.raises(RecordingError, match=r"first machine|not where it belongs"):
        judged.drawn(5, 3, None, YieldState(file, {"seed": "3"}))


def test_one_program_at_a_time_writes_the_file(tmp_path: Path) -> None:
    """Two programs that both appended left a file that was refused ever after."""
    file = tmp_path / "state"
    ours, theirs = socket.socketpair()

    def first() -> None:
        ours.close()
        state = YieldState(file, {"seed": "3"})
        theirs.send(b"open")
        assert state.known is None and theirs.recv(4) == b"end."

    other = child(first)
    theirs.close()
    try:
        assert ours.recv(4) == b"open"
        with pytest.raises(OptionError, match=r"another program writes .*state.* at this moment"):
            YieldState(file, {"seed": "3"})
        ours.send(b"end.")
    finally:
        ours.close()
        assert os.waitpid(other, 0)[1] == 0
    assert YieldState(file, {"seed": "3"}).known is None


def test_the_file_to_resume_is_no_other_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file is neither an input nor an output: its content must survive until the next time."""
    words = ["yield", str(JOB), "-m", "lathe-winder", "--variants", "2"]
    both = str(tmp_path / "both")
    for more in (["--resume", str(JOB)], ["--resume", both, "--worst", both], ["--resume", "/"]):
        with pytest.raises(SystemExit) as ended:
            main([*words, *more])
        captured = capsys.readouterr()
        assert (ended.value.code, captured.out, captured.err.count("\n")) == (2, "", 1)
    assert JOB.read_text().startswith(("%", "(", "N", "G", ";", "O"))
