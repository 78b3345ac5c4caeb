"""The guide to the machine in the panel: the same as from the command, read-only, and printable."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.live.bench import winder
from tests.panel.bench import LOCAL, KnownGuide, served
from threadline.report.guide import guide_of


def test_the_guide_is_that_of_the_machine_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(KnownGuide, "made", {})
    folder = tmp_path / "project"
    folder.mkdir()
    with served(folder, token="t" * 16) as client:
        assert client.get("/api/guide").status_code == 401
        known = {**LOCAL, "authorization": f"Bearer {'t' * 16}"}
        found = client.get("/api/guide", headers=known).json()
        printable = client.get("/api/guide.pdf", headers=known)
    expected = guide_of(winder()).tables
    assert found["machine"] == "lathe-winder"
    assert [one["title"] for one in found["tables"]] == [table.title for table in expected]
    assert found["tables"][-1]["title"] == "Calibration, step by step"
    assert found["tables"][-1]["note"]
    for rows, table in zip(found["tables"], expected, strict=True):
        assert rows["rows"] == [list(row) for row in table.rows]
    assert printable.headers["content-type"] == "application/pdf"
    assert printable.content.startswith(b"%PDF")
    assert list(folder.glob("*")) == []
