"""Designs on tapes (DST, U01) read for ``equal`` by pystitch, which did not write them.

A tape has places and events but no times: the machine sets its own timing. The places of the needle
are compared stitch by stitch, and thread changes and stops by the stitches before them.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.turns import Stitched
from threadline.readback.equal_found import Curve, Found, no_file_of, refusing, thinned

UNIT_M = 1e-4
"""Unit of a tape, m."""
PLACE_M = 0.5 * UNIT_M
_READERS = {"dst": "DstReader", "u01": "U01Reader"}
_STITCH, _STOP, _COLOUR, _NEEDLE = 0, 4, 5, 9  # acts of pystitch
_ACT = 0xFF
_CHANGES = ("colour", "stop")
_LARGEST_UNITS = 1e5  # units, 10 m: no frame is as large


def compare_tape(target: str, stitched: Stitched, path: Path, fresh: Path) -> Found:
    """Compare a design file with a plan, stitch by stitch.

    Parameters
    ----------
    fresh
        The file that ``compile`` writes for the plan. Every byte is compared with it, because the
        head of a tape has no stitches to compare.

    Raises
    ------
    RecordingError
        If pystitch cannot read the file.
    """
    what = f"design in {target.upper()}"
    with refusing(what, target, path):
        pattern = _read(target, path)
        stitches = np.array(
            [(x, y, int(act) & _ACT) for x, y, act in pattern.stitches], dtype=float
        )
        if not len(stitches) or not (stitches[:, 2] == _STITCH).any():
            raise no_file_of(what, target, path, "it has no stitches")
        if not np.isfinite(stitches).all() or np.abs(stitches[:, :2]).max() > _LARGEST_UNITS:
            raise no_file_of(what, target, path, "its stitches lie more than 10 m apart")
    sewn = stitches[:, 2] == _STITCH
    stitch_points = stitches[sewn, :2] * np.array([1.0, -1.0])  # pystitch has Y downwards
    stitches_before = np.cumsum(sewn)
    changes = stitches_before[np.isin(stitches[:, 2], (_STOP, _COLOUR, _NEEDLE))]
    planned = stitched.turns
    order = [stitched.axes.index(axis) for axis in ("X", "Y")]
    needle_down = planned.moves.needle == 1
    planned_points = np.cumsum(planned.moves.units[:, order], axis=0)[needle_down].astype(float)
    return _compared(
        stitched,
        stitch_points,
        planned_points,
        _tape_faults(stitch_points, planned_points, changes, stitched, path, fresh),
    )


def _read(target: str, path: Path) -> Any:
    from pystitch import EmbPattern

    pattern = EmbPattern()
    with path.open("rb") as file:
        importlib.import_module(f"pystitch.{_READERS[target]}").read(file, pattern)
    return pattern


def _tape_faults(
    stitch_points: FloatArray,
    planned_points: FloatArray,
    changes: IntArray,
    stitched: Stitched,
    path: Path,
    fresh: Path,
) -> list[str]:
    """Return differences that no limit covers."""
    faults = []
    if len(stitch_points) != len(planned_points):
        faults.append(f"{len(stitch_points)} stitches, the plan has {len(planned_points)}")
    turns = stitched.turns
    sewn = np.cumsum(turns.moves.needle == 1)
    ticks = [e.tick for e in turns.events if e.kind == "tool" and e.name in _CHANGES]
    planned_changes = np.array([sewn[tick - 1] if tick else 0 for tick in ticks], dtype=np.int64)
    # A tape may name its first needle, and end with a change that nothing follows.
    tape_changes, planned_changes = (
        np.sort(counts[(counts > 0) & (counts < len(planned_points))])
        for counts in (changes, planned_changes)
    )
    if not np.array_equal(tape_changes, planned_changes):
        first = next(
            (
                k
                for k, (a, b) in enumerate(zip(tape_changes, planned_changes, strict=False))
                if a != b
            ),
            -1,
        )
        change = f"{len(tape_changes)} thread changes, the plan has {len(planned_changes)}"
        if first >= 0:
            change = (
                f"thread change {first + 1} after stitch {tape_changes[first]}, "
                f"the plan's {planned_changes[first]}"
            )
        faults.append(change)
    if path != fresh and not faults:
        content, written = path.read_bytes(), fresh.read_bytes()
        if content != written:
            offset = next(
                (k for k, (a, b) in enumerate(zip(content, written, strict=False)) if a != b),
                min(len(content), len(written)),
            )
            faults.append(f"byte {offset} differs from the byte that compile writes")
    return faults


def _compared(
    stitched: Stitched, stitch_points: FloatArray, planned_points: FloatArray, faults: list[str]
) -> Found:
    count = min(len(stitch_points), len(planned_points))
    distances_m = UNIT_M * np.linalg.norm(stitch_points[:count] - planned_points[:count], axis=1)
    worst = int(np.argmax(distances_m)) if count else 0
    place = float(distances_m[worst]) if count else 0.0
    ends_s = np.cumsum(stitched.turns.turn_s)[stitched.turns.moves.needle == 1][:count]
    time_s, thinned_m = thinned(ends_s, distances_m)
    return Found(
        reader="pystitch",
        place=place,
        place_limit=PLACE_M,
        unit="m",
        tool_m=place,
        at=f"stitch {worst + 1}" if place else "",
        note="a tape has no times: the machine makes its own",
        wrong="; ".join(faults),
        curve=Curve(time_s=time_s, place=thinned_m),
    )
