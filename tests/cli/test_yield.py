"""``threadline yield`` as a command: its messages while it works."""

from __future__ import annotations

import resource
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.cli import yield_
from threadline.cli import yield_tables as why
from threadline.cli.main import main
from threadline.machine.variants import Uncertain
from threadline.proof import worst_machine
from threadline.proof.worst_search import WorstSearch
from threadline.search.machine_yield import Yield, criterion_cells, quantile
from threadline.verdict import CriterionRow, EachRun

JOB = Path(__file__).parents[2] / "examples" / "x-180.prg"


def test_every_stage_of_a_yield_tells_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A share if the number of machines is known, otherwise the number of tried machines."""
    reports: list[tuple[str, float]] = []

    @contextmanager
    def heard(_: bool):
        yield lambda stage, share: reports.append((stage, share))

    monkeypatch.setattr(yield_, "progress_bar", heard)
    monkeypatch.setattr(why, "MACHINES", 8)
    monkeypatch.setattr(why, "SAMPLES", 4)
    monkeypatch.setattr(yield_, "MACHINES", 20)
    job = tmp_path / "turn.prg"
    job.write_text("G91\nG1 X25.714 F2160\nG1 X-25.714\nM30\n", encoding="utf-8")
    words = ["yield", str(job), "-m", "lathe-winder", "--variants", "20", "--why"]
    with pytest.raises(SystemExit):
        main([*words, "--at-least", "80 %"])
    assert "error" not in capsys.readouterr().err
    stages = list(dict.fromkeys(stage.split(",")[0] for stage, _ in reports))
    assert stages == [
        "simulating and judging machines",
        "looking for the worst machine",
        "what the yield depends on",
        "looking for the cheapest set of tolerances",
    ]
    for stage in stages[0], stages[2]:
        shares = [share for name, share in reports if name == stage]
        assert shares == sorted(shares) and shares[-1] == pytest.approx(1.0)
        assert all(share < 1.0 for share in shares[:-1])
    for stage in stages[1], stages[3]:
        counts = [int(name.split(",")[1].split()[0]) for name, _ in reports if stage in name]
        assert len(counts) > 1 and counts == sorted(set(counts))


def test_a_wish_that_so_few_machines_cannot_prove_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """p^n = 2.5 %: 367 of 367 prove 99.0 %, 366 of 366 a little less."""
    words = ["yield", str(JOB), "-m", "lathe-winder", "--at-least", "99 %"]
    with pytest.raises(SystemExit) as ended:
        main([*words, "--variants", "366"])
    output = capsys.readouterr()
    assert (ended.value.code, output.out, output.err.count("\n")) == (2, "", 1)
    assert "366 machines" in output.err and "--variants 368" in output.err
    assert 0.025 ** (1 / 368) >= 0.99 > 0.025 ** (1 / 367)


@pytest.mark.parametrize("variants", [3, 40])
def test_sensitivities_of_machines_simulated_one_by_one_use_few_machines(variants: int) -> None:
    """As many machines as are drawn give the yields with halved tolerances."""
    asked: list[int] = []

    class OneByOne:
        together = False
        numbers = (Uncertain(name="a", numbers=("a",), normal=False),) * 2
        found = EachRun(
            rows=(
                CriterionRow(
                    name="x", axis="", step="", limit=1.0, unit="m", required=True, hard=False,
                    of_plan=False, values=np.ones(1), failed=np.zeros(1, dtype=bool),
                ),
            ),
            runs=1,
        )  # fmt: skip

        def judged(self, parts, done):
            asked.append(len(parts))
            return self.found.taken(np.zeros(len(parts), dtype=int))

        def drawn(self, count, seed, done):
            asked.append(count)
            return Yield(numbers=self.numbers, found=self.found, seed=seed)

        def halved(self, count, seed, done):
            asked.append(2 * count)
            return np.ones(2)

    sensitivities = why.sensitivities_of(OneByOne(), variants, 1, lambda stage, share: None)
    assert sensitivities.machines == variants
    assert sum(asked) == 3 * variants + 4 * 16


def test_a_yield_says_its_level_and_what_it_leaves_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Above the table and below it; the proven share of all machines is rounded down."""
    machine, job = tmp_path / "mine.toml", tmp_path / "turn.prg"
    machine.write_text(
        'base = "lathe-winder"\nname = "mine"\n[tolerances]\nexclude = ["drives.*"]\n',
        encoding="utf-8",
    )
    job.write_text("G91\nG1 X25.714 F1000\nG1 X-25.714\nM30\n", encoding="utf-8")
    words = ["yield", str(job), "-m", str(machine), "--variants", "8"]
    for more, level in ([], "drawn machines"), (["--at-least", "50 %"], "drawn machines"):
        with pytest.raises(SystemExit) as ended:
            main([*words, *more])
        printed = capsys.readouterr().out
        # 0.025 ** (1 / 8) is 0.630583
        line = f"8 of 8 machines in spec, at least 63.058 % of all ({level}: one run of each)"
        plain = " ".join(printed.split())
        assert plain.count(line) == 2 and printed.endswith(f"{line}\n")
        assert ended.value.code == 0
        assert "the same in every machine, excluded by the machine file: drives.x.torque" in plain
        assert "the same in every machine, it affects only plans: axes.A.acceleration," in plain


CONTOUR = '[[criteria]]\nname = "contour_error"\nlimit = "0.6 mm"\n'
REQUIRED = '[[criteria]]\nname = "{}"\nlimit = "0.1 mm"\nrequired = {}\n'


@pytest.mark.parametrize(
    ("name", "required", "status", "message"),
    [
        # It compares many runs of one machine: a yield has one run of each.
        ("repeatability", "true", 2, "repeatability is required and compares runs of one machine"),
        ("repeatability", "false", 0, "compares runs of one machine: repeatability"),
        # It needs stitches, which a part program does not have.
        ("seam_error", "true", 1, "seam_error is required, and was not measured"),
        ("seam_error", "false", 0, "4 of 4 machines in spec"),
    ],
)  # fmt: skip
def test_yield_lists_required_criteria_without_a_measurement(
    name: str,
    required: str,
    status: int,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(WorstSearch, "begin", lambda _: None)
    monkeypatch.setattr(WorstSearch, "go_on", lambda _: None)
    spec, job = tmp_path / "spec.toml", tmp_path / "turn.prg"
    spec.write_text(f'name = "s"\n{CONTOUR}{REQUIRED.format(name, required)}', encoding="utf-8")
    job.write_text("G91\nG1 X25.714 F1000\nG1 X-25.714\nM30\n", encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["yield", str(job), "-m", "lathe-winder", "-s", str(spec), "--variants", "4"])
    output = capsys.readouterr()
    assert ended.value.code == status
    assert message in " ".join((output.out + output.err).split())
    rows = [line.split() for line in output.out.splitlines() if line.split()[:1] == ["seam_error"]]
    assert rows == ([["seam_error", "-", "-", "-", "0.1", "mm", "4"]] if status == 1 else [])


def test_machines_that_ring_without_bound_count_in_the_distribution() -> None:
    """One of four: half of all have at most 2, and no number bounds 99 % of them."""
    values = np.array([1.0, np.inf, 3.0, 2.0])
    row = CriterionRow(
        name="contour_error", axis="", step="", limit=4.0, unit="m", required=True, hard=False,
        of_plan=False, values=values, failed=np.isinf(values),
    )  # fmt: skip
    assert (quantile(row, 0.5), quantile(row, 0.75)) == (2.0, 3.0)
    assert quantile(row, 0.99) == quantile(row, 1.0) == np.inf
    assert quantile(replace(row, values=np.array([1.0, 3.0, np.nan])), 0.5) == 2.0
    assert criterion_cells(row)[1:4] == ["2000 mm", "unbounded", "unbounded"]


@pytest.mark.parametrize(
    "words",
    [["yield", "--variants", "8"], ["prove", "--tolerances", "--law", "modified-sine"]],
    ids=lambda words: words[0],
)
def test_a_full_disk_keeps_the_worst_machine_that_was_there(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The system itself refuses to write on; the file is named, and no part of it is left."""
    job, worst = tmp_path / "turn.prg", tmp_path / "worst.toml"
    job.write_text("G91\nG1 X2 F1000\nM30\n", encoding="utf-8")
    worst.write_text("as before", encoding="utf-8")
    before, own = resource.getrlimit(resource.RLIMIT_FSIZE), worst_machine.worst_toml

    def limited(*given: object) -> str:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
        return own(*given)

    monkeypatch.setattr(worst_machine, "worst_toml", limited)
    try:
        with pytest.raises(SystemExit) as ended:
            main([words[0], str(job), "-m", "lathe-winder", *words[1:], "--worst", str(worst)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert ended.value.code == 2
    assert f"cannot use {worst}: File too large" in capsys.readouterr().err
    assert worst.read_text(encoding="utf-8") == "as before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["turn.prg", "worst.toml"]
