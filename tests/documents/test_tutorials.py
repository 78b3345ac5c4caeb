"""Every command of the tutorials runs and answers as its page shows; every example runs.

A page shows some lines of an answer, and may leave out the end of a line. A number agrees if it
differs by no more than one in its last digit.
"""

from __future__ import annotations

import json
import re
import runpy
import shlex
from pathlib import Path

import pytest

from tests.blank_pictures import blank_pictures
from threadline.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = sorted(
    page for page in (ROOT / "docs" / "tutorials").glob("*.md") if page.name != "index.md"
)
EXAMPLES = sorted([*(ROOT / "examples").glob("*.py"), *(ROOT / "examples").glob("*.ipynb")])
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"-?\d+(\.\d+)?")


def commands_of(block: str) -> list[tuple[list[str], int]]:
    """Return the words of each command of a block, and the exit status in its remark."""
    return [
        (shlex.split(line, comments=True)[1:], int("# out of spec" in line))
        for line in block.splitlines()
    ]


def answer(words: list[str], status: int, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the output of a command; it has to end with this exit status."""
    with pytest.raises(SystemExit) as stopped:
        main(words)
    output = capsys.readouterr()
    assert (stopped.value.code or 0) == status, (words, output.err)
    return output.out + output.err


def shows(page: str, message: str) -> bool:
    """Return whether a line of a page is the beginning of a printed line."""
    expected, found = page.split(), message.split()
    return len(expected) <= len(found) and all(map(same, expected, found))


def same(expected: str, found: str) -> bool:
    """Return whether words agree: numbers to one in the last digit, others except for a comma."""
    if NUMBER.fullmatch(expected) and NUMBER.fullmatch(found):
        return abs(float(expected) - float(found)) <= 1.01 * 10.0 ** -len(
            expected.partition(".")[2]
        )
    return expected.rstrip(",;") == found.rstrip(",;")


@pytest.mark.long(but="winder")
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_runs_and_shows_what_its_commands_answer(
    page: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In order, in a folder that holds the examples; other tests draw the pictures."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    blank_pictures(monkeypatch)
    verbs: list[str] = []
    message = ""
    for kind, block in FENCE.findall(page.read_text(encoding="utf-8")):
        if kind == "sh":
            commands = commands_of(block)
            verbs += [words[0] for words, _ in commands]
            message = "\n".join(answer(words, status, capsys) for words, status in commands)
        elif kind == "text":
            for line in block.splitlines():
                assert any(shows(line, other) for other in message.splitlines()), (line, message)
    assert "run" in verbs


@pytest.mark.long(only=("fastest_feed.py", "embroidery_tolerance.py"))
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda file: file.name)
def test_an_example_runs_and_prints_something(
    example: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    if example.suffix == ".py":
        runpy.run_path(str(example), run_name="__main__")
    else:
        run_notebook(example)
    assert capsys.readouterr().out


def run_notebook(file: Path) -> None:
    """Run the code of a notebook, which is stored without outputs, cell by cell."""
    names: dict[str, object] = {}
    for number, cell in enumerate(json.loads(file.read_text(encoding="utf-8"))["cells"]):
        if cell["cell_type"] == "code":
            assert not cell["outputs"] and cell["execution_count"] is None, file.name
            exec(compile("".join(cell["source"]), f"{file.name}[{number}]", "exec"), names)


def test_the_page_of_the_examples_names_each_of_them() -> None:
    page = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
    for example in EXAMPLES:
        assert f"`{example.name}`" in page


def test_the_gallery_shows_every_picture() -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    for picture in (ROOT / "docs" / "pictures").iterdir():
        assert f"](pictures/{picture.name})" in page
