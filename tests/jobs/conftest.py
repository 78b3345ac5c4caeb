"""Fixtures for every test of the readers."""

import pytest

from threadline.jobs.gcode import plain_blocks


@pytest.fixture(autouse=True)
def compiled_reader_from_the_first_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use the compiled reader from the first line: the programs of these tests are short."""
    monkeypatch.setattr(plain_blocks, "FIRST_LINES", 0)
