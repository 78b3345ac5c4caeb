"""Random programs with parameters and O words: every move ends where LinuxCNC's does."""

from __future__ import annotations

import math
import re
import shutil
from pathlib import Path

import pytest

from tests.jobs.controls_themselves import interpreted
from tests.jobs.in_dialects import millimetres
from tests.jobs.made_machines import made_machine
from tests.jobs.random_parametric import random_parametric
from threadline.errors import JobError
from threadline.jobs import read_job
from threadline.machine import Machine


@pytest.fixture(scope="module")
def xyza(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xyza"), "XYZ", "A")


@pytest.mark.linuxcnc
@pytest.mark.parametrize("first", (0, 6))
def test_linuxcnc_reckons_alike(tmp_path: Path, xyza: Machine, first: int) -> None:
    """To its 4 printed decimals; programs that it refuses are refused."""
    rs274 = shutil.which("rs274")
    if rs274 is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")
    moved = 0
    for seed in range(first, first + 6):
        program = tmp_path / "a.ngc"
        program.write_text(random_parametric(seed))
        output = interpreted(rs274, program)
        if "PROGRAM_END" not in output:
            with pytest.raises(JobError):
                read_job(program, xyza, dialect="linuxcnc")
            continue
        theirs = [
            [float(number) for number in re.findall(r"[-+]?[0-9]+\.[0-9]+", line)[:4]]
            for line in output.splitlines()
            if "STRAIGHT_" in line
        ]
        ours = millimetres(read_job(program, xyza, dialect="linuxcnc"))
        assert len(ours) == len(theirs), seed
        for mine, other in zip(ours, theirs, strict=True):
            assert all(math.isclose(a, b, abs_tol=6e-5) for a, b in zip(mine, other, strict=True))
        moved += len(ours)
    assert moved > 30
