"""Fixtures for every test of the judge."""

import pytest

from threadline.verdict import blocks


@pytest.fixture(autouse=True)
def short_blocks_stay_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep blocks as recorded, because these tests are about the ends of blocks."""
    monkeypatch.setattr(blocks, "FEW", 0)
    monkeypatch.setattr(blocks, "COPIED", 0)
