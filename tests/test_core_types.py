"""The additional runs of CI: the rounding of other processors, and no skipped test."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tools.core_types import (
    CORE_TYPES,
    NEEDS,
    NUMERICS,
    ROOT,
    flags_of,
    own_core_type,
    run_together,
    runs,
    words_for,
)

HERE = flags_of(Path("/proc/cpuinfo").read_text(encoding="utf-8"))
CPUINFO = "processor\t: 0\nflags\t\t: fpu pni avx fma avx512f\nprocessor\t: 1\nflags\t\t: fpu\n"


def test_a_core_type_that_would_stop_at_an_illegal_instruction_is_left_out():
    assert runs(flags_of(CPUINFO)) == list(CORE_TYPES) == list(NEEDS)
    assert runs(frozenset({"pni", "avx"})) == ["Prescott"]
    assert runs(flags_of("model name: none\n")) == []


def test_the_core_type_of_the_plain_run_is_not_run_again():
    flags = flags_of(CPUINFO)
    assert runs(flags, "SkylakeX") == ["Haswell", "Prescott"]
    assert runs(flags, "Zen") == runs(flags)


# OpenBLAS names its 128-bit kernels after Katmai.
@pytest.mark.parametrize("core", [core for core in CORE_TYPES[:2] if NEEDS[core] in HERE])
def test_numpy_says_which_core_type_it_has_picked(core: str):
    asked = "from tools.core_types import own_core_type; print(own_core_type())"
    output = subprocess.run(
        [sys.executable, "-c", asked],
        cwd=ROOT, capture_output=True, text=True, check=True,
        env=os.environ | {"OPENBLAS_CORETYPE": core},
    )  # fmt: skip
    assert output.stdout.strip() == core
    assert own_core_type() is not None


def test_the_folders_are_there():
    assert [name for name in NUMERICS if not (ROOT / "tests" / name).is_dir()] == []


def test_tests_independent_of_the_kernel_are_left_out(tmp_path: Path):
    """LinuxCNC's own times are tested once; tests with its interpreter run again."""
    case = (
        "import pytest\n"
        "def test_plain(): pass\n"
        "@pytest.mark.linuxcnc\ndef test_interpreter(): pass\n"
        "@pytest.mark.long(shown_by='test_plain')\ndef test_breadth(): pass\n"
        "@pytest.mark.waits\n@pytest.mark.linuxcnc\ndef test_planner(): pass\n"
    )
    for name in (*NUMERICS, "panel"):
        (tmp_path / "tests" / name).mkdir(parents=True)
    for file in ("panel/test_page.py", "commands/plc/test_scans.py", "motion/laws/test_b.py"):
        (tmp_path / "tests" / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tests" / file).write_text(case)
    of_laws = "tests/motion/laws/test_b.py::test_"
    for long, names in (
        (False, ("plain", "interpreter")),
        (True, ("plain", "interpreter", "breadth")),
    ):
        done = suite(tmp_path, "", "-rA", *words_for(long=long, workers=1))
        ran = re.findall(r"^PASSED (\S+)", done.stdout, re.MULTILINE)
        assert ran == [f"{of_laws}{name}" for name in names]


def test_a_run_with_cores_of_its_own_has_a_worker_for_each():
    words = words_for(long=False, workers=3)
    assert words[1:5] == ("-n", "3", "--dist", "worksteal")
    assert (words[0], *words[5:]) == tuple(
        word for word in words_for(long=False, workers=1) if word not in ("-p", "no:xdist")
    )


def test_runs_go_on_together_and_are_told_one_after_the_other(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    """Each waits for a message of the others: in sequence they would wait for ever."""
    code = (
        "import os, pathlib, sys, time\n"
        f"folder, own = pathlib.Path({str(tmp_path)!r}), os.environ['CORE']\n"
        "print(own, 'begins', flush=True)\n"
        "(folder / own).touch()\n"
        "end = time.monotonic() + 60\n"
        "while len(list(folder.iterdir())) < 3 and time.monotonic() < end: time.sleep(0.01)\n"
        "print(own, 'goes on')\n"
        "sys.exit(own == 'b' or time.monotonic() > end)\n"
    )
    commands = {name: (sys.executable, "-c", code) for name in "abc"}
    assert run_together(commands, "CORE") == ["b"]
    lines = [line for line in capfd.readouterr().out.splitlines() if not line.startswith("==")]
    assert lines == [f"{name} {what}" for name in "abc" for what in ("begins", "goes on")]


def suite(folder: Path, ci: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the tests of a folder with the rules of this suite."""
    (folder / "pytest.ini").write_text("[pytest]\n")
    here = {"CI": ci, "PYTEST_ADDOPTS": "", "PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT}"}
    return subprocess.run(
        [
            sys.executable, "-m", "pytest", "-q", "-p", "tests.conftest", "-p", "no:cacheprovider",
            *words,
        ],
        cwd=folder, capture_output=True, text=True, check=False, env=os.environ | here,
    )  # fmt: skip


@pytest.mark.long(shown_by="test_a_skipped_test_fails_in_ci_alone")
def test_a_second_run_has_what_the_first_did_not_show(tmp_path: Path):
    """Passed tests are left out; skipped ones, also whole files, and failed ones run."""
    (tmp_path / "test_all.py").write_text(
        "import os, pytest\n"
        "absent = pytest.mark.skipif(not os.environ.get('CI'), reason='rs274 is absent')\n"
        "@pytest.fixture\ndef spoilt():\n    yield\n    assert os.environ.get('CI')\n"
        "@pytest.mark.parametrize('text', ['a', 'b c\\n'])\ndef test_good(text): pass\n"
        "def test_spoilt(spoilt): pass\n"
        "@absent\ndef test_oracle(): pass\n"
    )
    (tmp_path / "test_page.py").write_text(
        "import os, pytest\n"
        "if not os.environ.get('CI'): pytest.skip('no browser', allow_module_level=True)\n"
        "def test_page(): pass\n"
    )
    first = suite(tmp_path, "", "-n", "1", "--note-passed=passed")
    assert "3 passed, 2 skipped, 1 error" in first.stdout
    second = suite(tmp_path, "true", "-rp", "-n", "1", "--except-noted=passed")
    ran = set(re.findall(r"PASSED test_\w+\.py::(\w+)", second.stdout))
    assert ran == {"test_spoilt", "test_oracle", "test_page"}, second.stdout
    assert "3 passed" in second.stdout
    whole = suite(tmp_path, "true", "--except-noted=absent")
    assert "5 passed" in whole.stdout


@pytest.mark.parametrize(("ci", "code"), [("true", 1), ("", 0)])
def test_a_skipped_test_fails_in_ci_alone(tmp_path: Path, ci: str, code: int):
    case = tmp_path / "test_oracle.py"
    case.write_text("import pytest\n\ndef test_oracle():\n    pytest.skip('rs274 is absent')\n")
    done = suite(tmp_path, ci)
    assert done.returncode == code, done.stdout
    assert ("skipped, which CI does not allow: rs274 is absent" in done.stdout) == bool(code)
