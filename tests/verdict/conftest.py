"""What every test of the judge starts from."""

import pytest

from threadline.verdict import blocks


@pytest.fixture(autouse=True)
def short_blocks_stay_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep blocks as they were recorded: tests are about what happens where one ends."""
    monkeypatch.setattr(blocks, "FEW", 0)
    monkeypatch.setattr(blocks, "COPIED", 0)
