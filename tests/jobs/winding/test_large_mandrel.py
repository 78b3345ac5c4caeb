"""A mandrel as large as a silo takes no unneeded planning time."""

from __future__ import annotations

from pathlib import Path

import pytest
from tools.fuzz_windings import SHORT

from threadline.base.arrays import FloatArray
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.winding.replay import Fibre, Replay


def test_the_check_of_a_large_mandrel_takes_chords_by_their_sagitta(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """40 m of radius in chords of half a millimetre were four million of them."""
    sizes: list[int] = []
    feed = Replay.feed

    def counted(self: Replay, eyes: FloatArray) -> Fibre:
        sizes.append(len(eyes))
        return feed(self, eyes)

    monkeypatch.setattr(Replay, "feed", counted)
    for radius in ("40 mm", "40 m"):
        path = tmp_path / "hoop.wind.toml"
        path.write_text(SHORT[0].decode().replace('"40 mm"', f'"{radius}"'))
        read_job(path, load_machine("lathe-winder"))
    small, large = sizes[0], sizes[-1]
    assert 10 < large / small < 100, "the turns are a thousand times as long"
