"""``compare`` searches the fastest of each, or names the command that does."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

import threadline as tl
from tests.test_limits_alone import files as limits_alone
from threadline.cli.main import main

pytestmark = pytest.mark.usefixtures("coarse_search")

EXAMPLES = Path(__file__).parents[2] / "examples"


def _compared(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as end:
        main(["compare", *words, "--nominal"])
    assert end.value.code in {0, 1}
    return capsys.readouterr().out


@pytest.mark.long(but="letter-cycle.toml-letter-placer-each shaper")
@pytest.mark.parametrize(
    ("name", "machine", "of"),
    [
        ("letter-cycle.toml", "letter-placer", "each shaper"),
        ("rosette.dst", "table-embroiderer", "each law"),
    ],
)
def test_compare_of_a_job_without_a_feed_names_the_command_that_searches(
    name: str, machine: str, of: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(EXAMPLES / name), "-m", machine]
    answer = json.loads(_compared(capsys, *words, "--json"))
    assert answer["fastest"] == {}
    assert answer["fastest_left_out"].startswith(f"The fastest of {of} is not searched")
    assert shlex.join(["threadline", "fastest", *words]) in answer["fastest_left_out"]
    assert "is not searched" in " ".join(_compared(capsys, *words).split())
    assert "is not searched" not in _compared(capsys, *words, "--no-fastest")


def test_limits_alone_and_a_job_with_feeds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limits, job = limits_alone(tmp_path, "G1 X20 A90 F1000\nG1 X0")
    answer = json.loads(_compared(capsys, str(job), "-m", str(limits), "--json"))
    assert "the machine file has no dynamics" in answer["fastest_left_out"]
    message = _compared(capsys, str(job), "-m", str(limits))
    assert "limits kept" in message and "in spec" not in message
    words = [str(EXAMPLES / "x-180.prg"), "-m", "lathe-winder", "--interpolation", "linear"]
    answer = json.loads(_compared(capsys, *words, "--json"))
    assert answer["fastest"]["linear"]["best"] > 0.0
    assert answer["fastest_left_out"] is None


def test_another_machine_runs_what_is_compared(capsys: pytest.CaptureFixture[str]) -> None:
    """As with ``prove``: the plans stay as they are, and the other machine runs them."""
    actual = "lathe-winder+stiction"
    words = [str(EXAMPLES / "x-180.prg"), "-m", "lathe-winder", "--interpolation", "linear"]
    answer = json.loads(_compared(capsys, *words, "--actual", actual, "--no-fastest", "--json"))
    proof = tl.prove(words[0], words[2], interpolation="linear", actual=actual, level="nominal")
    (compared,) = answer["proofs"]
    assert compared["criteria"] == proof.json()["criteria"]
    assert (
        compared["criteria"]
        != tl.prove(words[0], words[2], interpolation="linear", level="nominal").json()["criteria"]
    )
    found = tl.compare(words[0], words[2], ["linear"], actual=actual, level="nominal")
    assert f"run by {actual}, nominal" in repr(found)
    assert found.proofs[0].verdict.results == proof.verdict.results
