"""A recording's units are applied or refused; the samples are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from threadline.errors import RecordingError
from threadline.files import Channel, ChannelKind, Recording, RecordingBlock, Stream
from threadline.files.formats import read_recording, write_recording

from .makers import SERVO

VALUES = np.array([1.0, -2.5, 0.125])


def one_channel(kind: ChannelKind, unit: str) -> Recording:
    name = f"X.{kind}"
    return Recording(
        channels=(Channel(name=name, kind=kind, unit=unit, clock=SERVO, axis="X"),),
        blocks=Stream.of([RecordingBlock(first_tick={"servo": 0}, samples={name: VALUES})]),
        job_sha256="",
        machine_sha256="",
        simulated=False,
    )


def again(recording: Recording, folder: Path, ending: str) -> Recording:
    write_recording(recording, folder / f"a.{ending}")
    return read_recording(folder / f"a.{ending}")


@pytest.mark.parametrize("ending", ["npz", "csv"])
@pytest.mark.parametrize(
    ("kind", "unit", "si", "factor"),
    [
        (ChannelKind.LOAD, "mm", "m", 1e-3),
        (ChannelKind.TOOL, "um", "m", 1e-6),
        (ChannelKind.COMMANDED, "deg", "rad", np.pi / 180),
        (ChannelKind.VOLTAGE, "mV", "V", 1e-3),
        (ChannelKind.CURRENT, "mA", "A", 1e-3),
        (ChannelKind.FRAME, "m", "m", 1.0),
        (ChannelKind.INPUT, "", "", 1.0),
    ],
)
def test_units_are_applied(tmp_path: Path, ending, kind, unit, si, factor) -> None:
    found = again(one_channel(kind, unit), tmp_path, ending)
    assert found.channels[0].unit == si
    _, values = found.samples(f"X.{kind}")
    assert values == pytest.approx(VALUES * factor, rel=1e-15)


@pytest.mark.parametrize("ending", ["npz", "csv"])
@pytest.mark.parametrize(
    ("kind", "unit", "expected"),
    [
        (ChannelKind.LOAD, "V", "m or rad"),
        (ChannelKind.LOAD, "", "m or rad"),
        (ChannelKind.MEASURED, "count", "m or rad"),
        (ChannelKind.VOLTAGE, "mm", "V"),
        (ChannelKind.VOLTAGE, "parsnip", "V"),
        (ChannelKind.CURRENT, "V", "A"),
        (ChannelKind.OUTPUT, "V", "no unit"),
        (ChannelKind.OPERATION, "mm", "no unit"),
    ],
)
def test_units_of_another_kind_are_refused(tmp_path: Path, ending, kind, unit, expected) -> None:
    with pytest.raises(RecordingError, match=expected) as caught:
        again(one_channel(kind, unit), tmp_path, ending)
    assert f"X.{kind}" in str(caught.value)
    assert "\n" not in str(caught.value)
