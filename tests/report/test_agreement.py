"""One verdict in four forms: JSON, terminal, screen and paper."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pypdf import PdfReader

from tests.blank_pictures import blank_pictures
from threadline.cli.main import main
from threadline.cli.prove import show_proof
from threadline.machine import load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, Trials, prove
from threadline.report.proof import write_report
from threadline.search.report_data import report_data
from threadline.units import parse_quantity
from threadline.verdict import load_spec, verdict_json

SEAM = """
[stitching]
stitch_length = "2.5 mm"
needle_speed = "{speed} stitch/s"
motion = "discrete"

[[contour]]
unit = "mm"
points = [[0, 0], [20, 0], [20, 10]]
"""
PROGRAM = "G91 G1 X 30 F 2160\nX -30\nM30\n"  # Y and A stand still


def proof_of(
    folder: Path, name: str, text: str, machine: str, options: Options, runs: int = 1
) -> Proof:
    job = folder / name
    job.write_text(text)
    loaded = load_machine(machine)
    trials = Trials(repeats=runs)
    return prove(job, loaded, load_spec(None, loaded), options, trials=trials)


def winder(folder: Path) -> Proof:
    options = Options(interpolation="linear", feed=parse_feed("10 count/tick"))
    return proof_of(folder, "a.prg", PROGRAM, "lathe-winder", options)


def winder_out_of_spec(folder: Path) -> Proof:
    options = Options(interpolation="linear", feed=parse_feed("80 count/tick"))
    return proof_of(folder, "a.prg", PROGRAM, "lathe-winder", options)


def winder_repeated(folder: Path) -> Proof:
    options = Options(interpolation="auto", feed=parse_feed("10 count/tick"))
    return proof_of(
        folder,
        "a.prg",
        PROGRAM.replace("X 30", "X 3").replace("X -30", "X -3"),
        "lathe-winder",
        options,
        20,
    )


def stepper(folder: Path) -> Proof:
    return proof_of(folder, "a.prg", PROGRAM, "stepper-winder", Options())


def stitcher(folder: Path) -> Proof:
    return proof_of(folder, "a.seam.toml", SEAM.format(speed=60), "stitcher", Options())


def placer(folder: Path) -> Proof:
    example = Path(__file__).resolve().parents[2] / "examples" / "letter-cycle.toml"
    machine = "letter-placer"
    return proof_of(folder, "a.toml", example.read_text(), machine, Options(shaper="um-zv"))


def cells_of(page: str, title: str) -> list[list[str]]:
    """Return header and rows of a table of an HTML page."""
    table = page.partition(f"<h2>{title}</h2>")[2].partition("</table>")[0]
    rows = re.findall(r"<tr>(.*?)</tr>", table, re.S)
    return [[html.unescape(c) for c in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", r)] for r in rows]


def texts_of(pdf: Path) -> list[str]:
    """Return the text of each page without its figures, which take long to read."""
    pages = PdfReader(pdf).pages
    for page in pages:
        page["/Resources"].get_object().pop("/XObject", None)
    return [page.extract_text() for page in pages]


def same(criterion: dict[str, Any], what: str, shown: str) -> bool:
    """Return whether a printed figure is that of the JSON: its four digits, or less than 1e-9."""
    expected = criterion[what]
    if shown in ("-", "never"):  # JSON has no infinity
        return expected is None
    if expected is None:
        return False
    percent = shown.endswith("%")
    value = float(shown[:-1]) / 100.0 if percent else parse_quantity(shown, criterion["unit"])
    if criterion["name"] == "travel" and what == "measured" and expected < 0.0:
        return value == 0.0  # the rest of it stands in the note
    return value == pytest.approx(expected, rel=5e-3 if percent else 5e-4, abs=1e-9)


@pytest.mark.long(only="placer")
@pytest.mark.parametrize(
    "make", [winder, winder_out_of_spec, winder_repeated, stepper, stitcher, placer]
)
def test_json_terminal_screen_and_paper_tell_the_same(
    make: Callable[[Path], Proof],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Names, axes, statuses, lines; figures to the four printed digits."""
    blank_pictures(monkeypatch)
    proof = make(tmp_path)
    answer = verdict_json(proof.verdict, proof.plan)
    page = write_report(report_data(proof), tmp_path / "report").read_text(encoding="utf-8")
    show_proof(proof)
    terminal = capsys.readouterr().out
    paper = [re.sub(r"\s+", " ", text) for text in texts_of(tmp_path / "report" / "report.pdf")]

    header, *rows = cells_of(page, "Criteria")
    still = {c["axis"] for c in answer["criteria"] if c["name"] == "velocity" and not c["measured"]}
    assert {row[0] for row in rows} == {c["name"] for c in answer["criteria"]}
    for row in rows:
        shown = dict(zip(header, row, strict=True))
        assert shown["axis"] not in still or shown["status"] == "failed"
        status = shown["status"].removesuffix(" (required)")
        line = None if shown["line"] == "-" else int(shown["line"].split()[0])

        assert any(
            (c["name"], c["axis"], c["status"], c["job_line"])
            == (shown["criterion"], shown["axis"], status, line)
            and same(c, "measured", shown["measured"])
            and same(c, "limit", shown["limit"])
            for c in answer["criteria"]
        ), shown
        words = [cell for cell in row[:7] if cell]
        assert any(all(word in text for word in words) for text in terminal.splitlines())
        assert any(" ".join(words) in text for text in paper)

    worst = {c["run"] for c in answer["criteria"] if c["name"] == "contour_error"} - {None}
    expected = {(str(run), str(answer["runs"])) for run in worst}
    assert set(re.findall(r"Drawn is run (\d+) of (\d+), in which contour_error", page)) == expected
    assert bool(expected) == (answer["runs"] > 1)
    word = "IN SPEC" if answer["passed"] else "OUT OF SPEC"
    level = f"{answer['level']}: {answer['runs']} run"
    (verdict,) = re.findall(r'<span class="verdict (?:passed|failed)">(.*?)</span>', page)
    assert verdict.startswith(f"{word} ({level}")
    assert html.unescape(verdict) == terminal.splitlines()[-1]
    assert all(html.unescape(verdict) in text for text in paper)
    tightest = answer["tightest"]
    if tightest is not None and answer["passed"] == (tightest["share_of_limit"] <= 1.0):
        share, name = re.search(r"(\d+) % of (\S+)", verdict).groups()  # type: ignore[union-attr]
        assert name == tightest["name"]
        if f"more than {share} %" in verdict:  # beyond ten times the limit
            assert int(share) / 100.0 == 10.0 < tightest["share_of_limit"]
        else:
            assert 0.0 <= int(share) / 100.0 - tightest["share_of_limit"] < 0.01 + 1e-9


def test_bars_are_of_axes_that_move(tmp_path: Path) -> None:
    """For a program of X alone; A and Y still have results."""
    page = write_report(report_data(winder(tmp_path)), tmp_path / "report")
    assert not re.search(r'<figure id="profile-[AY]"', page.read_text(encoding="utf-8"))
    pdf = PdfReader(tmp_path / "report" / "report.pdf")
    text = "\n".join(each.extract_text() for each in pdf.pages)
    assert "turning_point_error X" in text
    assert not re.search(r"(error|velocity|jerk|acceleration) [AY]\b", text)


def test_the_report_has_the_warnings_that_the_terminal_has(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Warnings of the machine file are included, grouped by kind; each stands once."""
    blank_pictures(monkeypatch)
    job = tmp_path / "a.seam.toml"
    job.write_text(SEAM.format(speed=20))
    with pytest.raises(SystemExit):
        main(["prove", str(job), "-m", "stitcher", "--report", str(tmp_path / "report")])
    lines = capsys.readouterr().err.splitlines()  # a busy computer says "still at work"
    warned = [line for line in lines if line.startswith("warning: ")]
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    listed = [html.unescape(line) for line in re.findall(r"<li>(.*?)</li>", page)]
    assert [f"warning: {line}" for line in listed] == warned
    assert any("drives.x" in line and "(likewise drives.y)" in line for line in listed)
    assert len(listed) == len(set(listed)) >= 3
