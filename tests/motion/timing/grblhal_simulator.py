"""grblHAL's simulator: the places of its motors in each millisecond of its own time.

``THREADLINE_GRBLHAL`` names ``grblHAL_sim`` of github.com/grblHAL/Simulator with three axes, as
built by ``cmake .. && make``.
"""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray

STEPS_PER_MM = 80.0
_EVERY_S = 1e-3
_GAP_S = 5e-3  # without a queued block it prints nothing
_QUIET_S = 6.0  # of the clock: after this time nothing more comes
_LONGEST_S = 300.0
_OVER = "\x06"  # Ctrl-F


def installed() -> str | None:
    """Return the simulator; None if it is not named."""
    return os.environ.get("THREADLINE_GRBLHAL")


def places_on_grblhal(
    moves: list[str], settings: list[str], folder: Path, simulator: str
) -> tuple[FloatArray, FloatArray]:
    """Return (n,) times in s and (n, 2) places of X and Y in mm, while blocks are queued.

    The last tenth of a second is missing: it is in the steps' own buffer and no block any more.
    """
    printed = folder / "steps.out"
    words = ["-n", "-t", "1", "-r", str(_EVERY_S), "-e", str(folder / "settings.dat")]
    words += ["-b", os.devnull, "-s", str(printed), "-g", str(folder / "answers.txt")]
    with subprocess.Popen([simulator, *words], stdin=subprocess.PIPE, text=True) as running:
        assert running.stdin is not None
        # Its own time runs with the clock, so that its planner keeps up with its motors.
        running.stdin.write("".join(f"{line}\n" for line in [*settings, *moves]))
        running.stdin.flush()
        began = grown = time.monotonic()
        size = 0
        while time.monotonic() - grown < _QUIET_S or not size:
            if time.monotonic() - began > _LONGEST_S:
                running.kill()
                raise TimeoutError("the simulator does not come to an end")
            time.sleep(0.2)
            now = printed.stat().st_size if printed.exists() else 0
            if now != size:
                size, grown = now, time.monotonic()
        running.stdin.write(_OVER)
        running.stdin.flush()
        try:
            running.wait(_QUIET_S)
        finally:
            running.kill()
    # Before its greeting it reports that there were no settings yet.
    _, greeted, answers = (folder / "answers.txt").read_text().partition("GrblHAL")
    assert greeted and "error" not in answers, answers[-500:]
    rows = []
    for line in printed.read_text().splitlines()[:-1]:
        if not line.startswith("#"):
            rows.append([float(word) for word in line.replace(",", " ").split()[:3]])
    found = np.array(rows)
    apart = np.flatnonzero(np.diff(found[:, 0]) > _GAP_S)
    assert not len(apart), f"the planner ran dry at {found[apart, 0]} s: the computer is too busy"
    return found[:, 0], found[:, 1:] / STEPS_PER_MM
