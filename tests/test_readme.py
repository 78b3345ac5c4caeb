"""The commands of the README and of docs/commands.md run.

``tests/documents/test_one_plan.py`` runs the README's Python.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from tests.blank_pictures import blank_pictures
from threadline.cli.lazy import COMMANDS, SECTIONS
from threadline.cli.main import main

ROOT = Path(__file__).resolve().parent.parent
SHOWN = "\n".join(
    (ROOT / page).read_text(encoding="utf-8") for page in ("README.md", "docs/commands.md")
)

OUTPUTS = ("-o", "--deck", "--report", "--recording", "--proof")
SLOW = {"design": "its search takes minutes; tests/cli/test_design.py runs the command"}
SLOW["panel"] = "it serves until it is ended; tests/panel/test_panel_command.py runs it"
SLOW["connect"] = "it needs a controller; tests/live/test_connect.py has some"


def commands() -> list[tuple[list[str], int]]:
    """Return the words of every command of both pages, in order, and its expected exit status."""
    return [
        (shlex.split(line, comments=True)[1:], int("# out of spec" in line))
        for line in re.findall(r"^threadline .*", SHOWN, re.MULTILINE)
    ]


def test_both_pages_together_show_every_command_and_no_other() -> None:
    named = {words[0] for words, _ in commands()}
    assert named == set(COMMANDS)
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert named == set(re.findall(r"^threadline (\S+)", page, re.MULTILINE))


def test_the_page_of_the_commands_and_the_help_have_the_same_sections() -> None:
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    for title, section in SECTIONS.items():
        under = page.split(f"\n## {title}\n")[1].split("\n## ")[0]
        assert set(section) <= set(re.findall(r"^threadline (\S+)", under, re.MULTILINE)), title


@pytest.mark.long(
    shown_by="tests/documents/test_tutorials.py::test_a_tutorial_runs_and_shows_what_its_commands_answer"
)
@pytest.mark.usefixtures("coarse_search")
def test_the_commands_of_both_pages_run_in_order_and_write_below_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """They run as written, from a folder that holds the examples and nothing else.

    Only the first report is drawn. Other tests draw the other kinds in full: test_document,
    test_verdict of the embroidery and test_command of the analysis.
    """
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    written = set()
    for number, (words, status) in enumerate(commands()):
        if number == 1:
            blank_pictures(monkeypatch)
        outputs = [words[k + 1] for k, word in enumerate(words) if word in OUTPUTS]
        if words[0] in SLOW:
            assert all(name.startswith("reports/") for name in outputs)
            continue
        with pytest.raises(SystemExit) as stopped:
            main(words)
        output = capsys.readouterr()
        assert (stopped.value.code or 0) == status, (words, output.err)
        assert output.out
        written |= set(outputs)
    assert written
    assert all((tmp_path / name).exists() for name in written)
    assert {path.name for path in tmp_path.iterdir()} == {"examples", "reports"}


def test_every_link_of_the_documents_leads_somewhere() -> None:
    for file in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", file.read_text(encoding="utf-8")):
            if not target.startswith(("http:", "https:")):
                assert (file.parent / target).exists(), f"{file.name}: {target}"
