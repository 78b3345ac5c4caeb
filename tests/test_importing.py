"""Imports without unneeded modules, and without garbage collections."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import threadline
from threadline.base.importing import import_and_call
from threadline.live import hal_link as hal_process
from threadline.live import sim_process
from threadline.panel import calculation, owner_process, stored_traces

_SEEN = """
import gc
begun = []
gc.callbacks.append(lambda phase, info: begun.append(phase))
{words}
assert gc.isenabled() and gc.get_freeze_count() > 50_000
print(begun.count("start"))
"""


def test_a_process_begins_without_looking_for_garbage() -> None:
    """The hundred thousand objects of an import are never collected, then or later.

    Otherwise there are some hundred collections.
    """
    words = import_and_call("threadline.proof.pipeline", "__name__.upper")
    found = subprocess.run(
        [sys.executable, "-c", _SEEN.format(words=words)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert int(found.stdout) < 10


@pytest.mark.parametrize(
    "starts", [hal_process, sim_process, calculation, stored_traces, owner_process]
)
def test_the_processes_of_runs_and_of_the_panel_begin_so(starts: ModuleType) -> None:
    assert starts.CHILD.startswith("from threadline.base.importing import imported; ")


_PROVE = """
import sys
from threadline.cli.start import run
sys.argv = ["threadline", "prove", {job!r}, "-m", "lathe-winder", "--nominal"]
try:
    run()
except SystemExit:
    pass
print(*sorted(name for name in sys.modules if name.startswith("threadline.")))
"""


def test_a_proof_of_a_part_program_imports_what_it_uses(examples: Path) -> None:
    """Other kinds of work, other files and drawings are imported when they are first used.

    236 modules are imported, fifteen of them for the measures of a winding; a few may be added.
    """
    words = _PROVE.format(job=str(examples / "x-180.prg"))
    found = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    modules = found[-1].split()
    foreign = (
        "twin.switching", "twin.stitching", "proof.kinds.steps", "proof.kinds.switches",
        "commands.schedule", "commands.stitched", "commands.nc", "commands.structured_text",
        "commands.firmware", "commands.robust", "jobs.seam", "jobs.embroidery", "jobs.moves",
        "jobs.gcode.parametric", "geometry", "motion.laws", "motion.shaping",
        "motion.timing.firmware", "motion.timing.optimal", "report.figures", "search", "live",
        "panel",
    )  # fmt: skip
    assert "threadline.twin.simulate" in modules
    assert [m for m in modules if m.removeprefix("threadline.").startswith(foreign)] == []
    assert len(modules) < 238


_OTHER_PROGRAMS = ("jobs.gcode.part_program", "jobs.winding", "motion.timing.optimal")
_OTHER_DRAWINGS = ("geometry.read_csv", "geometry.read_dxf", "geometry.svg")
_OTHER_DESIGNS = tuple(f"jobs.embroidery.{name}" for name in ("hus", "pes", "t15", "vp3"))


@pytest.mark.parametrize(
    ("call", "used", "foreign"),
    [
        (
            "prove('x-180.prg', 'lathe-winder', level='nominal')",
            "jobs.gcode.part_program",
            (*_OTHER_PROGRAMS[1:], "jobs.seam", "jobs.embroidery", "geometry", "twin.switching"),
        ),
        (
            "prove('stitcher-even.seam.toml', 'stitcher', feed_forward=True, level='nominal')",
            "jobs.seam.job",
            (*_OTHER_PROGRAMS, *_OTHER_DRAWINGS, "jobs.embroidery", "twin.switching"),
        ),
        (
            "prove('letter-cycle.toml', 'letter-placer', level='nominal')",
            "twin.switching",
            (*_OTHER_PROGRAMS, "jobs.seam", "jobs.embroidery", "geometry", "twin.stitching"),
        ),
        (
            "prove('rosette.dst', 'schiffli-frame', level='nominal')",
            "twin.stitching",
            (*_OTHER_PROGRAMS, *_OTHER_DESIGNS, "jobs.seam", "geometry", "commands.step_files",
             "machine.days", "twin.switching"),
        ),
    ],
)  # fmt: skip
def test_a_proof_in_python_imports_what_its_kind_of_work_uses(
    examples: Path, call: str, used: str, foreign: tuple[str, ...]
) -> None:
    """At most 238 modules are imported; a few may be added."""
    words = f"import threadline as tl; tl.{call}; import sys; print(*sorted(sys.modules))"
    found = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, check=True, cwd=examples
    ).stdout.splitlines()
    modules = [name for name in found[-1].split() if name.startswith("threadline")]
    ours = [name.removeprefix("threadline.") for name in modules]
    assert used in ours
    assert [name for name in ours if f"{name}.".startswith(tuple(f"{n}." for n in foreign))] == []
    assert len(modules) < 245


def test_a_process_that_reads_a_drawing_loads_the_geometry_alone() -> None:
    words = import_and_call("threadline.panel.drawings", "__name__.upper")
    words += "; import sys; print(*sorted({name.split('.')[1] for name in sys.modules"
    words += " if name.startswith('threadline.')}))"
    found = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, check=True
    ).stdout.split()
    assert found == ["base", "errors", "geometry", "panel", "units"]


@pytest.mark.parametrize(
    ("call", "foreign"),
    [
        ("shaper('zv:12Hz')", ("machine", "jobs", "files", "dynamics", "motion.timing", "face")),
        (
            "retime([[0, 0], [0.1, 0], [0.1, 0.1]], velocity=[0.5, 0.5], acceleration=[2, 2])",
            (
                "machine",
                "dynamics",
                "motion.shaping",
                "motion.timing.averaged",
                "jobs",
                "proof",
                "face",
            ),
        ),
    ],
)
def test_calls_without_a_machine_import_no_machine_models(
    call: str, foreign: tuple[str, ...]
) -> None:
    """Then a shaper or a motion is ready within the first second of a program.

    Besides the files of the subject, only numpy, numba and numba's part of scipy are imported.
    """
    words = f"import threadline as tl; tl.{call}; import sys; print(*sorted(sys.modules))"
    modules = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, check=True
    ).stdout.split()
    # A package without its files is empty: it only names them.
    ours = [name.removeprefix("threadline.") for name in modules if name.startswith("threadline.")]
    assert [name for name in ours if name.startswith(tuple(f"{one}." for one in foreign))] == []
    # The streams of files alone, and no motion law: the whole packages would take 0.1 s.
    assert {"threadline.motion.laws", "threadline.files.commands"}.isdisjoint(modules)
    assert len(ours) < 45
    heavy = {"pydantic", "matplotlib", "typer", "scipy.optimize", "scipy.interpolate"}
    assert heavy.isdisjoint(modules)


def test_no_name_that_a_package_imports_later_is_the_name_of_its_file() -> None:
    """As soon as anyone imports the file, the package's name would mean the file."""
    source = Path(threadline.__file__).parent
    tables = [file for file in source.rglob("__init__.py") if "= later(" in file.read_text()]
    assert len(tables) > 3
    for file in tables:
        package = ".".join(("threadline", *file.parent.relative_to(source).parts))
        files = {one.stem for one in file.parent.iterdir()}
        assert files.isdisjoint(import_module(package).__all__), package
