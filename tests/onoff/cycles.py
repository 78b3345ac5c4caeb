"""Helpers for tests of a proved cycle: its machine, its altered recording, the command line."""

from __future__ import annotations

from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from typing import Any

import numpy as np
import pytest

from tests.made import Made
from threadline.cli.main import main
from threadline.files import Recording, RecordingBlock

TRIMMED = "letter-placer+whole-scans+own-damping"


def altered(recording: Recording, change: Any) -> Recording:
    def blocks() -> Any:
        whole = list(recording)
        samples = {k: np.concatenate([b.samples[k] for b in whole]) for k in whole[0].samples}
        change(samples)
        events = tuple(event for block in whole for event in block.events)
        yield RecordingBlock(first_tick=whole[0].first_tick, samples=samples, events=events)

    return replace(recording, blocks=Made(blocks))


def run(*words: str) -> tuple[int, str]:
    output = StringIO()
    with pytest.raises(SystemExit) as stopped, redirect_stdout(output):
        main(list(words))
    return int(stopped.value.code or 0), output.getvalue()
