"""A yield in parts: merged to the same bits as in one run, or the wrong part is named."""

from __future__ import annotations

import errno
import json
import random
import shutil
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.search.plans import JOB
from threadline.cli import yield_sharing as of_command
from threadline.cli.main import main
from threadline.errors import OptionError, RecordingError
from threadline.proof import worst_search
from threadline.search import yield_parts
from threadline.search.machine_yield import MachineYield, Yield
from threadline.search.yield_parts import Part, parse_part, read_part, read_parts
from threadline.verdict import EachRun

TURN = "G91\nG1 X5 F1000\nG1 X-5\nM30\n"
_COMPILES = "compiling machine code"
RunCommand = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run_command(capsys: pytest.CaptureFixture[str]) -> RunCommand:
    """Run ``threadline yield``; return its exit status, answer and errors."""

    def run(*words: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(["yield", *map(str, words)])
        captured = capsys.readouterr()
        # The first command on a computer also reports that it compiles.
        err = [line for line in captured.err.splitlines(keepends=True) if _COMPILES not in line]
        return int(ended.value.code or 0), captured.out, "".join(err)

    return run


@pytest.fixture
def turn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The words of a yield of nine winders, in a folder of their own."""
    monkeypatch.chdir(tmp_path)
    Path("turn.prg").write_text(TURN, encoding="utf-8")
    return ["turn.prg", "-m", "lathe-winder", "--variants", "9", "--seed", "5"]


@pytest.fixture
def three(turn: list[str], run_command: RunCommand) -> list[Path]:
    """The files of its three parts."""
    return made_parts(run_command, turn, 3)


def there() -> list[str]:
    """Return the names in the present folder."""
    return sorted(path.name for path in Path().iterdir())


def made_parts(run_command: RunCommand, words: list[str], count: int) -> list[Path]:
    """Make every part of a yield, in any order."""
    files = [Path(f"{k + 1}-of-{count}.yield") for k in range(count)]
    order = list(range(count))
    random.Random(count).shuffle(order)
    for k in order:
        code, out, err = run_command(*words, "--part", f"{k + 1}/{count}", "-o", files[k])
        assert (code, out.count("\n")) == (0, 1) and "error" not in err
    return files


@pytest.mark.long(but="many at once")
@pytest.mark.parametrize(
    ("job", "machine", "exclude", "variants"),
    [
        (JOB.read_text(encoding="utf-8"), "lathe-winder", ["drives.*", "inputs.*", "axes.*"], 50),
        (TURN, "stepper-winder", ["drives.*"], 17),
    ],
    ids=["many at once", "one by one"],
)
def test_merged_parts_are_one_run_to_the_bit(
    job: str, machine: str, exclude: list[str], variants: int, run_command: RunCommand,
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Count, interval, table, worst machine and its file, from 3 and 16 parts in any order.

    The worst machine is searched among few machines, because few of their numbers vary; the search
    is the same, whole or merged.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(worst_search, "SEARCHED_SERIAL", 10)
    Path("job.prg").write_text(job, encoding="utf-8")
    Path("few.toml").write_text(
        f'base = "{machine}"\nname = "few"\n[tolerances]\nexclude = {json.dumps(exclude)}\n',
        "utf-8",
    )
    words = ["job.prg", "-m", "few.toml", "--variants", str(variants), "--seed", "7"]
    words += ["--interpolation", "linear"]
    judged: list[EachRun] = []
    own = MachineYield.worst

    def heard(self: MachineYield, known: Yield, done: Any) -> Any:
        judged.append(known.found)
        return own(self, known, done)

    monkeypatch.setattr(MachineYield, "worst", heard)
    one = run_command(*words, "--worst", "worst.toml", "--json"), Path("worst.toml").read_bytes()
    content = json.loads(one[0][1])
    assert content["variants"] == variants and content["worst"]["numbers"]
    table = run_command(*words)
    for count in 3, 16:
        files = made_parts(run_command, words, count)
        random.Random(variants).shuffle(files)
        Path("worst.toml").unlink()
        again = run_command("--merge", *files, "--worst", "worst.toml", "--json")
        assert (again, Path("worst.toml").read_bytes()) == one
    assert run_command("--merge", *files) == table
    whole, *others = [
        [
            (row.name, row.axis, row.limit, row.values.tobytes(), row.failed.tobytes())
            for row in rows
        ]
        for rows in (found.rows for found in judged)
    ]
    assert len(others) == 4 and all(rows == whole for rows in others)


def test_every_machine_is_in_one_part_by_its_number() -> None:
    for variants, count in (10, 3), (16, 16), (100_003, 16), (10_000_000, 9_999_999):
        some = range(1, count + 1) if count < 100 else (1, 2, count // 2, count)
        parts = [Part(k, count).machines(variants) for k in some]
        assert parts[0].start == 0 and parts[-1].stop == variants
        assert all(len(part) in {variants // count, variants // count + 1} for part in parts)
        if count < 100:
            assert [k for part in parts for k in (part.start, part.stop)][1:-1] == [
                k for part in parts[1:] for k in (part.start, part.start)
            ]


@pytest.mark.parametrize(
    "text",
    ["0/0", "17/16", "-1/3", "0/3", "three", "3", "", "1/3/5", "1.5/3", "²/3", "1/" + "9" * 99],
)  # fmt: skip
def test_malformed_part_is_refused(text: str, run_command: RunCommand, turn: list[str]) -> None:
    with pytest.raises(OptionError):
        parse_part(text)
    code, out, err = run_command(*turn, f"--part={text}", "-o", "x.yield")
    assert (code, out, err.count("\n")) == (2, "", 1) and "--part" in err
    assert not Path("x.yield").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--part", "1/10", "-o", "x"], "9 machines are too few for 10 parts"),
        (["--part", "1/3"], "no file for its results"),
        (["--part", "1/3", "-o", "turn.prg"], "is the input"),
        (["--part", "1/3", "-o", "/dev/stdout"], "the output of the answer itself"),
        (["--part", "1/3", "-o", "x", "--resume", "x"], "the same file"),
        (["--part", "1/3", "-o", "x", "--why"], "--why needs the whole yield"),
        (["--part", "1/3", "-o", "x", "--at-least", "5 %"], "--at-least needs the whole yield"),
        (["--part", "1/3", "-o", "x", "--worst", "w.toml"], "--worst needs the whole yield"),
        (["--part", "1/3", "-o", "x", "--merge"], "exclude each other"),
        (["-o", "x"], "there is no --part"),
        (["turn.prg"], "there are 2 jobs"),
        (["--merge"], "--machine was given"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    words: list[str], says: str, run_command: RunCommand, turn: list[str]
) -> None:
    code, out, err = run_command(*turn, *words)
    assert (code, out, err.count("\n")) == (2, "", 1) and says in err
    assert there() == ["turn.prg"] and Path("turn.prg").read_text() == TURN


def test_a_missing_a_doubled_and_a_foreign_part_are_named(
    three: list[Path], turn: list[str], run_command: RunCommand, tmp_path: Path
) -> None:
    before = {file: file.read_bytes() for file in three}
    a, b, c = three
    shutil.copy(b, "copy.yield")
    other: dict[str, list[str]] = {
        "seed": [*turn[:-1], "6"],
        "number of machines": [*turn, "--variants", "12"],
        "machine": ["turn.prg", "-m", "lathe-winder+physical", *turn[3:]],
        "set of options": [*turn, "--feed", "10 mm/s"],
        "specification": [*turn, "-s", "own.spec.toml"],
        "job": ["other.prg", *turn[1:]],
    }
    Path("own.spec.toml").write_text(
        'name = "own"\n[[criteria]]\nname = "contour_error"\nlimit = "0.4 mm"\nrequired = true\n'
    )
    Path("other.prg").write_text(TURN.replace("X5", "X6").replace("X-5", "X-6"))
    foreign = {}
    for name, words in other.items():
        code, _, err = run_command(
            *words, "--part", "2/3", "-o", foreign.setdefault(name, Path(name))
        )
        assert code == 0, err
    run_command(*turn, "--part", "2/4", "-o", "four.yield")
    for files, says in [
        ([a, c], "1 of 3 parts missing: 2."),
        ([c], "2 of 3 parts missing: 1, 2."),
        ([a, b, c, Path("copy.yield")], f"part 2/3 is there twice: '{b}' and 'copy.yield'"),
        ([a, Path("four.yield"), c], "'four.yield' belongs to another yield"),
        ([a, tmp_path / "none", c], "none"),
        ([a, tmp_path, c], "Is a directory"),
        ([a, Path("turn.prg"), c], "turn.prg:1: a part of a yield cannot be read"),
        *(([a, file, c], f"another {name}") for name, file in foreign.items()),
    ]:
        code, out, err = run_command("--merge", *files, "--worst", "worst.toml")
        assert (code, out, err.count("\n")) == (2, "", 1) and says in err
        if any(file in foreign.values() for file in files):
            assert f"'{files[1]}' belongs to another yield than '{a}'" in err
    assert {file: file.read_bytes() for file in three} == before
    assert not Path("worst.toml").exists()


def test_a_part_of_other_versions_files_or_bits_is_named(
    three: list[Path], turn: list[str], run_command: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, key in ("numpy", "version of numpy"), ("threadline", "version of threadline"):
        with monkeypatch.context() as patch:
            if name == "numpy":
                patch.setattr(of_command, "version", lambda _: "0.0.1")
            else:
                patch.setattr(of_command, "__version__", "0.0.1")
            assert run_command(*turn, "--part", "2/3", "-o", "old.yield")[0] == 0
            # All parts have the same version, and another version merges them.
            code, _, err = run_command("--merge", *three)
            assert code == 2 and key in err and "than this Threadline and the files here" in err
        code, _, err = run_command("--merge", three[0], "old.yield", three[2])
        assert code == 2 and "'old.yield' belongs to another yield" in err and key in err
    # A computer with other bits: the last bit of the first machine differs.
    part = read_part(three[1])
    row = next(row for row in part.found.rows if row.limit is not None and (row.values > 0).any())
    row.values[0] = np.nextafter(row.values[0], 0.0)
    yield_parts.write_part(Path("bits.yield"), part.record, part.found)
    code, out, err = run_command("--merge", three[0], "bits.yield", three[2])
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "part 2/3 in 'bits.yield' has other results here" in err
    # The job was changed, or is missing.
    Path("turn.prg").write_text(TURN.replace("F1000", "F900"), encoding="utf-8")
    code, _, err = run_command("--merge", *three)
    assert code == 2 and "another job" in err
    Path("turn.prg").unlink()
    code, _, err = run_command("--merge", *three)
    assert (code, err.count("\n")) == (2, 1) and "job 'turn.prg', and it is not here" in err


@pytest.mark.parametrize(("given", "value"), [("--seed", "3"), ("--feed", "1 mm/s")])
def test_a_merge_takes_its_options_from_the_parts(
    given: str, value: str, three: list[Path], run_command: RunCommand
) -> None:
    code, out, err = run_command("--merge", *three, given, value)
    assert (code, out) == (2, "") and f"{given} was given" in err


def test_a_part_that_was_cut_is_refused_wherever_it_was_cut(
    three: list[Path], monkeypatch: pytest.MonkeyPatch, turn: list[str], run_command: RunCommand
) -> None:
    monkeypatch.setattr(yield_parts, "AT_ONCE", 1)  # one line for each machine
    assert run_command(*turn, "--part", "2/3", "-o", "whole.yield")[0] == 0
    whole, cut = Path("whole.yield").read_bytes(), Path("cut.yield")
    lines = {k + 1 for k, byte in enumerate(whole) if byte == 10}
    assert len(lines) == 4
    for length in sorted({*range(0, len(whole), 97), *lines, len(whole) - 1} - {len(whole)}):
        cut.write_bytes(whole[:length])
        with pytest.raises(RecordingError, match="cannot be read"):
            read_part(cut)
    cut.write_bytes(whole + whole.splitlines(True)[-1])
    with pytest.raises(RecordingError, match="should stand here"):
        read_part(cut)
    cut.write_bytes(whole[: max(lines - {len(whole)})])
    code, _, err = run_command("--merge", three[0], cut, three[2])
    assert (code, err.count("\n")) == (2, 1) and "2 of its 3 machines: it is cut short" in err


ODD: tuple[Any, ...] = (None, True, -1, 0, 0.5, 10**30, "", "x", [], [0, 0], [4, 3], {}, {"a": []})


def test_no_changed_record_is_a_defect(three: list[Path], run_command: RunCommand) -> None:
    """With a right check sum a changed record is refused in one line, or means the same."""
    first, rest = three[1].read_bytes().split(b"\n", 1)
    record = json.loads(first.partition(b" ")[2])
    bad = Path("bad.yield")
    places = [(key,) for key in record] + [("words", key) for key in record["words"]]
    for place in [*places, ("words", "feed"), ("words", "no-such-word"), ("identity", "x")]:
        for odd in ODD:
            changed = json.loads(json.dumps(record))
            part = changed
            for key in place[:-1]:
                part = part[key]
            part[place[-1]] = odd
            body = json.dumps(changed).encode()
            bad.write_bytes(b"%08x %s\n%s" % (zlib.crc32(body), body, rest))
            try:
                read_parts([three[0], bad, three[2]])
            except (OptionError, RecordingError) as error:
                assert "\n" not in str(error)
            else:
                assert place[0] == "words"
                code, out, err = run_command("--merge", bad)
                assert (code, out, err.count("\n")) == (2, "", 1)


def test_a_full_disk_and_an_interrupt_leave_no_half_file(
    turn: list[str], run_command: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("old.yield").write_text("old", encoding="utf-8")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(yield_parts.os, "fsync", full)
    for name in "old.yield", "deep/new.yield":
        code, out, err = run_command(*turn, "--part", "2/3", "-o", name)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert f"cannot use {name}: No space left on device" in err
    assert there() == ["old.yield", "turn.prg"]

    def interrupted(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(yield_parts.os, "fsync", interrupted)
    code, out, _ = run_command(*turn, "--part", "2/3", "-o", "old.yield")
    assert code == 130 and out == ""
    assert there() == ["old.yield", "turn.prg"]
    assert Path("old.yield").read_text(encoding="utf-8") == "old"


@pytest.mark.long(shown_by="test_a_full_disk_and_an_interrupt_leave_no_half_file")
def test_a_file_size_limit_leaves_no_half_file(turn: list[str], tmp_path: Path) -> None:
    """The system itself refuses to write on."""
    words = [*turn, "--part", "2/3", "-o", "part.yield"]
    code = (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "from threadline.search import yield_parts\n"
        "own = yield_parts.write_part\n"
        "def limited(*given):\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "    own(*given)\n"
        "from threadline.cli import yield_sharing as of_command\n"
        "of_command.write_part = limited\n"
        f"from threadline.cli.main import main; main({['yield', *words]!r})\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "cannot use part.yield: File too large" in done.stderr
    assert there() == ["turn.prg"]


def test_a_part_that_was_broken_off_goes_on(
    three: list[Path], turn: list[str], run_command: RunCommand
) -> None:
    words = [*turn, "--part", "2/3", "-o", "again.yield", "--resume", "state"]
    assert run_command(*words)[0] == 0
    state = Path("state").read_bytes()
    Path("again.yield").unlink()
    assert run_command(*words)[0] == 0
    assert Path("again.yield").read_bytes() == three[1].read_bytes()
    assert Path("state").read_bytes() == state
    # The file is the state of this part alone.
    for other in ["--part", "3/3", "-o", "x"], []:
        code, _, err = run_command(*turn, *other, "--resume", "state")
        assert code == 2 and "begun with another part" in err
