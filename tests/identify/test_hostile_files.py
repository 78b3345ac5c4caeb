"""Randomly damaged measured data: an error in one line, or a response."""

from __future__ import annotations

import random

import numpy as np

from threadline.errors import InputError
from threadline.identify.frequency_domain import ResponseData
from threadline.identify.measured_data import open_data

from . import forward

_WORDS = ("nan", "inf", "-1", "1e400", "", '"', "#", ";", "\t", "\0", "é", "[rad/s/V]", "coherence",
          "0", "1e-320", "[", "# axis:", "9" * 400, "time [s]", "1_0")  # fmt: skip


def spoilt(text: str, rng: random.Random) -> str:
    """Return a text with some cells, lines or characters replaced, repeated or removed."""
    lines = text.splitlines()
    for _ in range(rng.randint(1, 4)):
        at = rng.choice((0, 1, 2, rng.randrange(len(lines))))
        at = min(at, len(lines) - 1)
        cells = lines[at].split(",")
        way = rng.randrange(5)
        if way == 0:
            cells[rng.randrange(len(cells))] = rng.choice(_WORDS)
            lines[at] = ",".join(cells)
        elif way == 1 and len(lines) > 1:
            del lines[at]
        elif way == 2:
            lines.insert(at, lines[rng.randrange(len(lines))])
        elif way == 3:
            lines[at] = lines[at][: rng.randrange(len(lines[at]) + 1)]
        else:
            lines[at] += rng.choice(_WORDS)
    return rng.choice(("\n", "\r\n", "\r")).join(lines)


def test_spoilt_responses_are_read_or_refused_in_one_line(tmp_path):
    rng = random.Random(43)
    usual = forward.write_csv(tmp_path / "usual.csv", forward.stitcher_x()).read_text()
    with_coherence = "# output: sensors.x\nfrequency_hz,magnitude [count/V],phase_deg,coherence\n"
    with_coherence += "".join(f"{f},{10 / f},-90,0.99\n" for f in range(1, 9))
    file, read = tmp_path / "x.csv", 0
    for number in range(200):
        file.write_text(spoilt(rng.choice((usual, with_coherence)), rng), newline="")
        try:
            data = open_data(str(file), "stitcher", "X")
        except InputError as error:
            assert "\n" not in str(error).strip(), number
            continue
        if isinstance(data, ResponseData):
            read += 1
            residual = data.residuals({"drives.x.delay": np.array([3e-3])})
            assert np.isfinite(residual).all(), number
    assert read > 10
