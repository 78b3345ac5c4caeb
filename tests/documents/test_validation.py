"""The validation pages agree with the answers of their commands: the rows with a quick command.

``python -m tools.validation --check --long`` also compares the others. All together take half a
minute of processor time.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from tools import claims, validation

ROWS = [row for page in validation.pages() for row in validation.rows_of(page)]
QUICK = [row for row in ROWS if row.compared and not row.takes]
MACHINES = ("winder", "stitcher", "placer", "embroidery")
STEP = next(row for row in QUICK if row.command.endswith("winder-step 0.45"))
PROVED = next(row for row in QUICK if row.command.endswith("rosette.dst -m schiffli-frame"))
LAW = 'threadline law --mode %s --damping 0.02 --move "16.5 mm" --time "120 ms" '
LIMITS = '--limit "6.33 m/s^2" --residual "0.05 mm" --band %s'


@pytest.fixture(autouse=True)
def at_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(validation.ROOT)


@pytest.mark.long(
    only=(
        "threadline prove examples/cone-dome-cylinder.prg -m lathe-winder",
        "threadline yield examples/x-180.prg -m lathe-winder --variants 2000 --seed 1",
        "python -m tools.claims frame-windows 12",
        "python -m tools.claims stitcher-two-stitches 51",
        "python -m tools.claims stitcher-two-stitches 55",
        "python -m tools.second_search letter-placer X 0",
        "python -m tools.second_search letter-placer Z 0",
        "threadline equal examples/rosette.dst -m schiffli-frame --targets steps",
        LAW % "12Hz" + LIMITS % "0.2",
        LAW % "20Hz" + LIMITS % "0.1",
        "threadline analyse stitcher --experiments",
        "threadline analyse stitcher+slack-belt --experiments",
        "threadline prove examples/stitcher-75.seam.toml -m examples/stitcher-75.toml"
        ' --feed-forward --smoothing "24 ms"',
    )
)
@pytest.mark.parametrize("command", dict.fromkeys(row.command for row in QUICK), ids=str)
def test_rows_have_the_figures_that_their_command_answers(command: str) -> None:
    """The command answers with the printed digits, the verdict and the level of the row."""
    wrong = [
        f"{row.page.name}:{row.line}: {row.claim}: {text}"
        for row in QUICK
        if row.command == command
        for text in validation.differences(row)
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("machine", MACHINES)
def test_each_machine_has_a_page_that_says_what_no_specification_has(machine: str) -> None:
    text = (validation.ROOT / "docs" / f"validation-{machine}.md").read_text(encoding="utf-8")
    assert [row for row in ROWS if row.page.stem == f"validation-{machine}"]
    assert "## What the source demands" in text and "**no specification**" in text
    assert f"(validation-{machine}.md)" in (validation.ROOT / "docs" / "validation.md").read_text(
        encoding="utf-8"
    )


def test_every_row_says_its_level_and_can_be_asked_for() -> None:
    """Its test exists, its claim is one of the tool's, and its numbers have places."""
    for row in ROWS:
        words = row.command.split()
        assert row.level in (*validation.LEVELS, "model"), row
        if words[0] == "pytest":
            assert all((validation.ROOT / word).exists() for word in words[1:]), row
            assert not row.answers, row
        else:
            assert row.answers and row.numbers, row
            assert words[:3] != ["python", "-m", "tools.claims"] or words[3] in claims.NAMES, row


def test_a_wrong_figure_verdict_or_level_is_noticed() -> None:
    printed = STEP.numbers[0][0]
    off = dataclasses.replace(STEP, here=STEP.here.replace(printed, printed[:-1] + "9", 1))
    assert not validation.differences(STEP) and len(validation.differences(off)) == 1
    for change in ({"level": "nominal"}, {"here": PROVED.here.replace("in spec", "out of spec")}):
        changed = dataclasses.replace(PROVED, **change)
        if changed != PROVED:
            assert len(validation.differences(changed)) == 1


def test_a_number_without_a_place_is_refused() -> None:
    with pytest.raises(ValueError, match="numbers are printed"):
        validation.figures_of(dataclasses.replace(STEP, here="1, 2, 3, 4 ms"))


def test_validation_table_has_the_program_figures_in_the_printed_digits() -> None:
    wrong = STEP.here.replace(STEP.numbers[0][0], "1.0", 1)
    row = dataclasses.replace(STEP, here=wrong)
    assert validation.value_of("16 542") == (16542.0, pytest.approx(0.51))
    digits = f"{validation.figures_of(STEP)[0]:.1f}"
    assert validation.rewritten(row) == wrong.replace("1.0", digits, 1)


def test_a_unit_is_of_the_numbers_before_it_as_well() -> None:
    def read(here: str) -> list[float]:
        row = dataclasses.replace(STEP, here=here)
        return validation.factors(here, row.numbers)

    assert read("1, 2 mm, 3 %") == [1e3, 1e3, 1e2]
    assert read("1.95 stitches, 3 %") == [1.0, 1e2]
    assert read("500 rad/s, 0.7") == [1.0, 1.0]


def test_a_row_without_a_command_is_refused(tmp_path: Path) -> None:
    page = tmp_path / "validation-made.md"
    head = "| " + " | ".join(validation.COLUMNS) + " |\n|---|---|---|---|---|---|\n"
    page.write_text(head + "| a | b | c | d | model | none |\n", encoding="utf-8")
    with pytest.raises(ValueError, match="no command"):
        list(validation.rows_of(page))


def test_a_record_is_compared_and_so_is_its_bound(tmp_path: Path) -> None:
    page = tmp_path / "validation-made.md"
    head = "| " + " | ".join(validation.RECORDS) + " |\n|---|---|---|---|---|---|---|\n"
    law = "`threadline law modified-sine`: `Ca`"
    row = f"| a | `b` | 5.528 | model | {{}} | {law} | {law} |\n"
    page.write_text(head + row.format("5.528") + row.format("5.6"), encoding="utf-8")
    found = list(validation.rows_of(page))
    assert [one.claim for one in found] == ["a, `b`", "a, `b`: bound"] * 2
    assert [len(validation.differences(one)) for one in found] == [0, 0, 0, 1]
    page.write_text(head + row.format("-"), encoding="utf-8")
    assert [one.claim for one in validation.rows_of(page)] == ["a, `b`"]
