"""A sample that no machine can have measured is refused before it is squared."""

from __future__ import annotations

import pytest

from threadline.errors import RecordingError
from threadline.files import ChannelKind
from threadline.verdict import judge, load_spec

from .builders import follow, plan_through, record, winder

POINTS = [[0.0, 0.0], [0.01, 0.0], [0.01, 0.01]]


@pytest.mark.parametrize("value", [1e300, -3e16, 2e15])
def test_an_absurd_sample_is_refused_with_its_channel(value: float) -> None:
    """1e300 squared overflows; then numpy would warn before the refusal."""
    path, operation = follow(POINTS, 20)
    actual = path.copy()
    actual[7, 1] = value
    channels = {ChannelKind.COMMANDED: path, ChannelKind.LOAD: actual}
    recording = record(("X", "Y"), channels, operation)
    with pytest.raises(RecordingError, match=r"channel 'Y\.load' has a sample of .*beyond 1e\+15"):
        judge([recording], plan_through(POINTS), load_spec(None, winder()))
