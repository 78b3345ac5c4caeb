"""The thinned trace of a stored run, and whether its actual positions were measured."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from threadline.files import Channel, ChannelKind, Clock, Recording, RecordingBlock, Stream
from threadline.panel.thinned_traces import thinned

CLOCK = Clock("tick", Fraction(1, 200))


def recorded(*kinds: ChannelKind) -> Recording:
    """Return a recording of X with a command and other channels."""
    samples = {kind.value: np.linspace(0.0, 0.1, 50) + 1e-3 * k for k, kind in enumerate(kinds)}
    channels = [
        Channel(name=kind.value, kind=kind, unit="m", axis="X", clock=CLOCK) for kind in kinds
    ]
    block = RecordingBlock(first_tick={"tick": 0}, samples=samples)
    return Recording(
        channels=tuple(channels), blocks=Stream.of([block]), job_sha256="", machine_sha256="",
        simulated=True,
    )  # fmt: skip


@pytest.mark.parametrize("kind", [ChannelKind.LOAD, ChannelKind.MEASURED])
def test_a_measured_position_is_the_actual_one(kind: ChannelKind) -> None:
    axis = thinned(recorded(ChannelKind.COMMANDED, kind))["axes"]["X"]
    assert axis["measured"] is True
    difference = np.array(axis["actual"]) - np.array(axis["commanded"])
    np.testing.assert_allclose(difference, 1e-3, atol=1e-7)


def test_a_command_alone_is_no_measurement() -> None:
    """This holds for a controller with grbl: the difference would be zero, as in a perfect run."""
    axis = thinned(recorded(ChannelKind.COMMANDED))["axes"]["X"]
    assert axis["measured"] is False
    assert axis["actual"] == axis["commanded"]
