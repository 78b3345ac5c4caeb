"""Motion whose planning takes minutes: the progress, or the reason, is reported."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from threadline.base.progress import PLANNING, WritingSoFar
from threadline.cli.main import main
from threadline.cli.messages import WRITING_STAGE, Telling

X_180 = str(Path(__file__).resolve().parents[2] / "examples" / "x-180.prg")


def proved(machine: str, interpolation: str) -> object:
    with pytest.raises(SystemExit) as ended:
        main(["prove", X_180, "-m", machine, "--interpolation", interpolation, "--nominal"])
    return ended.value.code


@pytest.mark.parametrize(
    ("interpolation", "message"),
    [
        ("auto", r"planning, 10\.\d+ s of motion so far"),
        ("optimal", r"planning, motion of 10\.\d+ s, time \d+ of at most 16"),
    ],
)
def test_progress_of_planning_is_printed(interpolation: str, message: str) -> None:
    """The program takes 10 s at its feed."""
    PLANNING.reach(0.0)
    assert Telling(stage="planning").doing() == "planning"
    proved("lathe-winder", interpolation)
    assert re.fullmatch(message, Telling(stage="planning").doing())
    assert Telling(stage="searching").doing() == "searching"


def test_the_share_of_a_program_that_is_written_only_grows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program is written and read back, once or twice: one share for everything."""
    reports: list[str] = []
    shares: list[float] = []
    reach = WritingSoFar.reach
    telling = Telling(stage=WRITING_STAGE)

    def noted(self: WritingSoFar, motion_s: float, whole_s: float) -> None:
        reach(self, motion_s, whole_s)
        shares.append(self.share)
        reports.append(telling.doing())

    monkeypatch.setattr(WritingSoFar, "reach", noted)
    out = ["--target", "linuxcnc", "-o", str(tmp_path / "out.ngc")]
    with pytest.raises(SystemExit) as ended:
        main(["compile", X_180, "-m", "lathe-winder", *out])
    assert ended.value.code == 0
    assert shares == sorted(shares) and shares[0] < 0.2 and shares[-1] >= 0.4
    message = r"writing and reading back, \d+ % done"
    assert re.match(message, reports[0])
    assert any(re.fullmatch(f"{message}, about .* more", one) for one in reports)


def test_a_jerk_that_takes_ages_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The winder's 10.5 m/s^2 would take three hundred years at 1e-9 m/s^3."""
    machine = tmp_path / "slow.toml"
    machine.write_text('base = "lathe-winder"\n[path]\njerk = "1e-9 m/s^3 exact, assumed"\n')
    assert proved(str(machine), "auto") == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert re.search(r"slow\.toml.*with the jerk limit of axis [AX], .* ticks; the machine", err)
