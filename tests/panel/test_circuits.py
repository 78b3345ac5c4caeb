"""The number of circuits on the panel, compared with the circuits along the rows of the table."""

from __future__ import annotations

from pathlib import Path

import pytest

from threadline.jobs.reading import read_job
from threadline.machine import load_machine
from threadline.panel.calculating import circuits_and_points
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.report.lines import count_circuits

MACHINE = load_machine("lathe-winder")


@pytest.mark.parametrize(
    ("calls", "circuits", "moves"),
    [
        ("N 40 M98 P 999 L 3;\n", 3, 6),
        ("N 40 M98 P 999 L 7;\n", 7, 14),
        ("N 40 M98 P 999 L 1;\nN 50 M98 P 999 L 1;\n", 2, 4),
        ("N 40 M98 P 997 L 4;\n", 4, 4 * 12),
        ("N 40 X 5;\n", None, 1),
    ],
)
def test_circuits_are_the_passes_of_outermost_calls(
    tmp_path: Path, calls: str, circuits: int | None, moves: int
) -> None:
    file = tmp_path / "circuits.prg"
    file.write_text(
        "%\nO 999 N 10 X 9;\nN 15 X -9 M99;\nO 997 N 17 X 1;\nN 20 M98 P 999 L 5;\nN 22 X -1 M99;\n"
        f"O 998;\nN 25 G01 F 2000;\nN 30 G91;\n{calls}N 90 M30;\n%\n"
    )
    job = read_job(file, MACHINE)
    assert circuits_and_points(job) == (circuits, moves)
    assert count_circuits(plan_job(job, MACHINE, Options())).circuits == (circuits or 1)
