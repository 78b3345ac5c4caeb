"""A redesign in parts: merged to the same bits as in one run, or the wrong part is named."""

from __future__ import annotations

import json
import random
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.search.test_design_front import CLOSE, QUICK, TURN
from threadline.cli.main import main
from threadline.search import design as of_search
from threadline.search import design_parts
from threadline.search.design_evaluate import Evaluator
from threadline.search.design_parts import read_design_part

RunCommand = Callable[..., tuple[int, str, str]]
WORDS = ["turn.prg", "-m", "lathe-winder", "-s", "close.toml", "--nominal"]
WORDS += ["--interpolation", "linear", "--front", "12"]


@pytest.fixture
def run_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> RunCommand:
    """Run ``threadline design`` in a folder with a job; return exit status, answer and errors."""
    monkeypatch.chdir(tmp_path)
    Path("turn.prg").write_text(TURN, encoding="utf-8")
    Path("close.toml").write_text(CLOSE, encoding="utf-8")
    monkeypatch.setattr(of_search, "THOROUGH", QUICK)

    def run(*words: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(["design", *map(str, words)])
        captured = capsys.readouterr()
        err = [line for line in captured.err.splitlines(keepends=True) if line.startswith("error")]
        return int(ended.value.code or 0), captured.out, "".join(err)

    return run


def made(run_command: RunCommand, count: int, *more: str) -> list[Path]:
    """Make every part, in any order."""
    files = [Path(f"{k + 1}-of-{count}.design") for k in range(count)]
    order = list(range(count))
    random.Random(count).shuffle(order)
    for k in order:
        code, out, err = run_command(*WORDS, *more, "--part", f"{k + 1}/{count}", "-o", files[k])
        assert (code, out.count("\n"), err) == (0, 1, "")
    return files


@pytest.mark.long(but="two searches")
@pytest.mark.parametrize(
    ("number", "parts"),
    [(2, [(2, [])]), (3, [(3, []), (2, ["--searches", "3"])])],
    ids=["two searches", "three searches"],
)
def test_merged_parts_are_one_run_to_the_bit(
    run_command: RunCommand, number: int, parts: list[tuple[int, list[str]]]
) -> None:
    """The answer, the front and the files of three searches, in three parts and in two."""
    one = run_command(*WORDS, "--searches", number, "-o", "found.toml", "--json")
    written = [Path(name).read_bytes() for name in ("found.toml", "found.spec.toml")]
    assert one[0] == 0 and json.loads(one[1])["front"]
    for count, more in parts:
        files = made(run_command, count, *more)
        random.Random(7).shuffle(files)
        for name in "found.toml", "found.spec.toml":
            Path(name).unlink()
        assert run_command("--merge", *files, "-o", "found.toml", "--json") == one
        again = [Path(name).read_bytes() for name in ("found.toml", "found.spec.toml")]
        assert again == written
    numbers = range(number)
    searches = [read_design_part(Path(f"{k + 1}-of-{number}.design")).searches for k in numbers]
    assert [one.number for some in searches for one in some] == [*numbers]
    tried = {one.tried.points.tobytes() for some in searches for one in some}
    assert len(tried) == number  # each with its own random numbers
    one_by_one = json.loads(run_command(*WORDS, "--json")[1])
    content = json.loads(one[1])
    assert content["found"]["cost"] <= one_by_one["found"]["cost"]
    assert content["simulated"] > (number - 1) * one_by_one["simulated"]


def test_parts_that_do_not_fit_are_named(
    run_command: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, two, three = made(run_command, 3)

    def refused(*files: object) -> str:
        code, out, err = run_command("--merge", *files, "-o", "found.toml")
        assert (code, out, err.count("\n")) == (2, "", 1), err
        assert not Path("found.toml").exists()
        return err

    assert "2 of 3 parts missing: 2, 3" in refused(one)
    assert "part 2/3 is there twice" in refused(one, two, two, three)

    def other(*words: str) -> Path:
        run_command(*WORDS, "--part", "2/3", "-o", "other.design", *words)
        return Path("other.design")

    assert "another number of machines of --front" in refused(one, other("--front", "5"), three)
    assert "another choice of --corners" in refused(one, other("--corners"), three)
    message = refused(one, other("--searches", "4"), three)
    assert "'other.design' belongs to another redesign than '1-of-3.design'" in message
    assert "another number of searches" in message
    assert "another set of options" in refused(one, other("--limits", "90 %"), three)
    Path("turn.prg").write_text(TURN.replace("X5", "X6"), encoding="utf-8")
    assert "another job" in refused(one, other(), three)
    assert "than this Threadline and the files here: another job" in refused(one, two, three)
    Path("turn.prg").write_text(TURN, encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr(design_parts, "version", lambda name: "1.0")
        message = refused(one, two, three)
        assert "another version of numpy, version of scipy, version of numba" in message
    with monkeypatch.context() as patch:
        tried = Evaluator.tried

        def rounded_otherwise(self: Evaluator, *given: Any, **named: Any) -> Any:
            result = tried(self, *given, **named)
            return replace(result, ratio=np.nextafter(result.ratio, np.inf))

        patch.setattr(Evaluator, "tried", rounded_otherwise)
        assert "another result of the machine as its file says" in refused(one, two, three)
    Path("turn.prg").unlink()
    assert "the parts are of job 'turn.prg', and it is not here" in refused(one, two, three)


def test_a_changed_part_is_named_with_its_line(run_command: RunCommand) -> None:
    (file,) = made(run_command, 1)
    whole = file.read_bytes()
    head, search = whole.splitlines(keepends=True)

    def refused(content: bytes) -> str:
        file.write_bytes(content)
        code, out, err = run_command("--merge", file)
        assert (code, out, err.count("\n")) == (2, "", 1), err
        return err

    def summed(line: bytes, old: bytes, new: bytes) -> bytes:
        body = line.partition(b" ")[2].rstrip(b"\n")
        assert old in body
        body = body.replace(old, new, 1)
        return b"%08x %s\n" % (zlib.crc32(body), body)

    assert "1-of-1.design:2: " in refused(head + search.replace(b"simulated", b"simulatec"))
    assert "its last line is cut short" in refused(whole[:-1])
    assert "it has 0 of its 1 searches: it is cut short" in refused(head)
    assert "it has more searches than its part" in refused(whole + search)
    assert "not a part of a redesign of this version" in refused(
        summed(head, b"design part 1", b"design part 9") + search
    )
    for old, new in (
        (b'"dims":', b'"dims":1'), (b'"candidates":', b'"candidates":9'),
        (b'"search":0', b'"search":1'), (b'"level":"', b'"level":"A'),
        (b'"criteria":[', b'"criteria":[3,'), (b'"machines":12', b'"machines":13'),
        (b'"cost":', b'"cost":null,"old":'), (b'"points":', b'"point":'),
    ):  # fmt: skip
        assert "1-of-1.design:2: " in refused(head + summed(search, old, new))
    assert "number of searches is not from 1" in refused(
        summed(head, b'"searches":1', b'"searches":0') + search
    )


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--part", "0/0", "-o", "x"], "--part '0/0'"),
        (["--part", "4/3", "-o", "x"], "--part '4/3'"),
        (["--part", "1/3"], "--part has no file for its results"),
        (["--part", "1/3", "-o", "/dev/stdout"], "the output of the answer itself"),
        (["--part", "1/3", "-o", "turn.prg"], "turn.prg"),
        (["--part", "1/3", "--searches", "2", "-o", "x"], "2 searches are too few for 3 parts"),
        (["--part", "1/3", "-o", "x", "--report", "r"], "--report needs the whole redesign"),
        (["--part", "1/3", "-o", "x", "--plot", "rotors,amplifiers"], "--plot needs the whole"),
        (["--part", "1/3", "-o", "x", "--merge"], "--part and --merge exclude each other"),
        (["--merge"], "--machine was given"),
        (["-o", "x"], "is no name for a machine file"),
        (["turn.prg"], "there are 2 jobs"),
        (["--searches", "0"], "--searches"),
    ],
)
def test_impossible_part_of_a_redesign_is_refused(
    words: list[str], says: str, run_command: RunCommand
) -> None:
    before = Path("turn.prg").read_bytes()
    code, out, err = run_command(*WORDS, *words)
    assert (code, out) == (2, "") and says in err, err
    assert Path("turn.prg").read_bytes() == before and not Path("x").exists()


def test_the_level_of_a_merge_is_that_of_its_parts(run_command: RunCommand) -> None:
    (file,) = made(run_command, 1)
    for word in "--nominal", "--tolerances", "--corners":
        code, _, err = run_command("--merge", file, word)
        assert code == 2 and f"{word} was given" in err
    code, _, err = run_command("--merge", "close.toml")
    assert code == 2 and "it is not a part of a redesign" in err
