"""A short run of the long fuzz: hostile files end in one line, never in a traceback."""

from __future__ import annotations

import random
import warnings

import pytest
from tools.fuzz_files import fuzz_targets, seeds

from threadline.errors import RecordingError


def mutate(rng: random.Random, data: bytes) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 2, 8))):
        at = rng.randrange(len(out) + 1)
        if rng.random() < 0.5:
            out[at : at + 1] = bytes([rng.randrange(256)])
        else:
            del out[at : at + rng.choice((1, 9, 99999))]
    return bytes(out)


TARGETS = fuzz_targets(mutate)


@pytest.mark.parametrize("name", TARGETS)
def test_hostile_files_end_in_one_line(tmp_path, name) -> None:
    file, make, read, _ = TARGETS[name]
    path = tmp_path / file
    path.write_bytes(seeds()[name])
    read(path)  # the seed itself is good
    refused = 0
    for number in range(400):
        rng = random.Random(f"{name}/{number}")
        path.write_bytes(make(rng))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                read(path)
        except RecordingError as error:
            refused += 1
            assert "\n" not in str(error), number
    assert refused > 150
