"""A job proved and run by the command line: both have the same verdict and the same recording."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.made import read_once
from threadline.cli.main import main
from threadline.files.formats import read_recording

_EXAMPLES = Path(__file__).parents[2] / "examples"


def check_same_when_run(
    folder: Path, capsys: pytest.CaptureFixture[str], job: str, machine: str, *options: str
) -> None:
    """Prove and run an example: criteria and every channel are equal, bit for bit."""
    how = (str(_EXAMPLES / job), "-m", machine, "--nominal", "--json", *options)
    verdicts, recordings = [], []
    for words in (("prove",), ("run", "--speed", "0", "--store", str(folder / "runs"))):
        file = folder / f"{words[0]}.npz"
        with pytest.raises(SystemExit) as ended:
            main([words[0], *how, *words[1:], "--recording", str(file)])
        assert ended.value.code in (None, 0)
        verdicts.append(json.loads(capsys.readouterr().out)["criteria"])
        recordings.append(read_once(read_recording(file)))
    assert verdicts[0] == verdicts[1]
    first, second = recordings
    for channel in first.channels:
        assert np.array_equal(first.samples(channel.name), second.samples(channel.name))
