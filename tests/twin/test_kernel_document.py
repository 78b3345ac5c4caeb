"""The page on the engine shows the engine as it is, and its example can be followed."""

from __future__ import annotations

import doctest
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "twin-kernel.md"

TRY_IT = """
import sys
from pathlib import Path

import numpy as np
from tests.twin.random_machines import Maker
from tests.twin.reference_twin import reference_run

from threadline.machine.load import load_machine
from threadline.files import Stream, TickBlock, TickTable
from threadline.twin import BatchOptions, simulate, simulate_batch

OUT_AND_BACK = np.concatenate((np.ones(12), -np.ones(16), np.zeros(8))).astype(np.int64)
for seed in (2, 8, 21):
    text = Maker(seed).text()
    assert 'kind = "soft-start"' in text, f"seed {seed} has no soft start any more"
    loads = {}
    for kind in ("soft-start", "p"):
        plain = text.replace('kind = "soft-start"', 'kind = "p"').replace("ticks = ", "# ")
        file = Path(f"{kind}-{seed}.toml")
        file.write_text(text if kind == "soft-start" else plain)
        machine = load_machine(str(file))
        counts = np.stack([30 * OUT_AND_BACK for _ in machine.axes], axis=1)
        table = TickTable(
            clock=machine.tick_clock, axes=machine.axis_names,
            counts_per_unit=machine.counts_per_unit,
            start_counts=np.zeros(len(machine.axes), dtype=np.int64),
            blocks=Stream.of([TickBlock(first_tick=0, counts=counts,
                                        operation=np.zeros(len(counts), dtype=np.int64))]),
            job_sha256="", machine_sha256=machine.sha256,
        )
        how = {"quantised": bool(seed % 2), "settle_s": 9.5 * float(machine.tick_clock.period_s)}
        recording = simulate(table, machine, **how)
        loads[kind] = {axis: recording.samples(f"{axis}.load")[1] for axis in machine.axes}
        if kind == "p":
            continue
        rows = {axis: 30 * OUT_AND_BACK for axis in machine.axes}
        expected, _ = reference_run(machine, rows, quantised=how["quantised"], settle=10)
        body = next(iter(machine.bodies))
        alike = {f"bodies.{body}.inertia": np.full(9, machine.bodies[body].inertia.si)}
        names = tuple(f"{axis}.load" for axis in machine.axes)
        many = simulate_batch(table, machine, alike, options=BatchOptions(channels=names, **how))
        for axis, load in loads[kind].items():
            scale = machine.axes[axis].counts.si
            np.testing.assert_allclose(
                load * scale, expected[f"{axis}.load"] * scale, rtol=0, atol=1e-6
            )
            for variant in many.samples[f"{axis}.load"].T:
                np.testing.assert_array_equal(variant, load)
    apart = [np.abs(loads["soft-start"][a] - loads["p"][a]).max() * machine.axes[a].counts.si
             for a in machine.axes]
    assert max(apart) > 1e-3, "a soft start is no other controller"
print("followed")
"""


def test_the_page_runs() -> None:
    found = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8")
    assert found.failed == 0 and found.attempted > 12


def changed(text: str, hunk: list[str]) -> str:
    """Return ``text`` with a hunk of a diff applied; its lines must stand in one place."""
    before = "".join(line[1:] + "\n" for line in hunk if line[0] in " -")
    after = "".join(line[1:] + "\n" for line in hunk if line[0] in " +")
    assert text.count(before) == 1, f"the page changes {text.count(before)} places:\n{before}"
    return text.replace(before, after)


@pytest.mark.long(shown_by="test_the_page_runs")
def test_the_example_can_be_followed(tmp_path: Path) -> None:
    """Engine and slow twin agree to 1e-6 counts, as everywhere; the difference is 7e-9."""
    for folder in ("src", "tests"):
        # With byte code: it goes by the time and size of its source, which are copied too. What
        # others write meanwhile may be gone before it is copied.
        being_written = shutil.ignore_patterns("*.lock", "*.tmp.*")
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=being_written)
    made = 0
    for block in re.findall(r"```diff\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL):
        for part in re.split(r"(?m)^--- ", block)[1:]:
            name, *hunks = re.split(r"\n@@\n", part)
            file = tmp_path / name.strip()
            text = file.read_text("utf-8")
            for hunk in hunks:
                # An empty line of a diff is one of the file.
                text = changed(text, [line or " " for line in hunk.rstrip("\n").split("\n")])
                made += 1
            file.write_text(text, "utf-8")
    assert made > 15
    (tmp_path / "try_it.py").write_text(TRY_IT, "utf-8")
    where = os.pathsep.join((str(tmp_path / "src"), str(tmp_path)))
    done = subprocess.run(
        [sys.executable, "try_it.py"], cwd=tmp_path, text=True, capture_output=True, check=False,
        env={**os.environ, "PYTHONPATH": where},
    )  # fmt: skip
    assert done.stdout.split() == ["followed"], done.stderr
