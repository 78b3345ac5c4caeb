"""Mandrels and bands from files of other planners: FiberPath's (``fiberpath.py``), and CADFIL's.

CADFIL's help describes the fibre path ``.FIB`` and the payout path ``.PAY`` field by field, and
says that a control file ``.CTL`` lists payout files. CADFIL 9 adds lines that the help does not
describe: settings, ``$NAME=VALUE``, and notes, ``ANR...``. These lines are skipped. In its ``.FIB``
the number of points follows NELE. A path of CADFIL shows the mandrel only where its fibre lies, and
points that CADFIL inserts between the computed points lie on chords below the mandrel. So the
mandrel is read from the mandrel file ``.MND`` that every path names, if this file is in the folder
of the path.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from threadline.base.reading import read_text
from threadline.errors import JobError, Place
from threadline.winding.fiberpath import FRICTION, NAMED, SUFFIX, Content, WindFile

ENDINGS = (SUFFIX, ".fib", ".pay", ".ctl")
"""Endings of the files that ``foreign_product`` reads, in lower case."""
MERIDIANS = (".fib", ".pay", ".mnd")
"""Endings of the files that ``meridian_of`` reads."""
_MAX_BYTES = 20_000_000
_MOST_POINTS = 200_000
_MOST_MM = 1e6
_SAME_POINT_M = 1e-5  # two points of a meridian are one
_FIB_LINES, _PAY_LINES = 4, 4  # before the points
_WITH_COUNT = 2  # numbers of the line with NELE, if the number of points stands there
_FIB_WIDTHS = (5, *(11,) * 6)
_PAY_WIDTHS = (10,) * 9
_NOTE_MARKS = ("$", "ANR")  # settings and notes of CADFIL 9
_MANDREL = "XRDATA"  # begins a mandrel file that turns about an axis
_MND_WIDTHS = (20, 20, 8, 12)
_LEAST_MM = 1e-3  # a smaller radius is the axis
_NAME = re.compile(r"[^\s,;\"']+")


def foreign_product(path: Path) -> Content:
    """Return the content of a product file (``product.py``) from the file of another planner.

    Raises
    ------
    JobError
        If the file cannot be read, is damaged, or does not describe a body of revolution.
    """
    ending = path.suffix.lower()
    if ending == SUFFIX:
        return WindFile(path).product()
    paths = [path] if ending != ".ctl" else list(_listed_payouts(path))
    widths = [_width_mm(payout_file) for payout_file in paths]
    if max(widths) > min(widths):
        raise JobError(
            f"its payout files have bands of {min(widths):g} to {max(widths):g} mm",
            place=Place(str(path)),
            remedy="Replay them one by one.",
        )
    parts = _mandrel_of(paths)
    if parts is None:
        parts = [
            _meridian(_joined_paths([_cadfil_points(payout_file) for payout_file in paths]), path)
        ]
    return {
        "name": f"{path.stem} ({NAMED})",
        "mandrel": {"at": f"{1e3 * parts[0][0][0]:.9g} mm"},
        "part": [{"points": part} for part in parts],
        "band": {"width": f"{widths[0]!r} mm"},
        "friction": {"value": FRICTION},
    }


def meridian_of(path: Path) -> list[list[float]]:
    """Return places along the axis and radii, m, of CADFIL's mandrel, or of the one under a path.

    Raises
    ------
    JobError
        As ``foreign_product``.
    """
    if path.suffix.lower() != ".mnd":
        return _meridian(_cadfil_points(path), path)
    parts = _mandrel(path)
    return [*parts[0], *(point for part in parts[1:] for point in part[1:])]


def _mandrel_of(paths: Sequence[Path]) -> list[list[list[float]]] | None:
    """Return the parts of the mandrel that paths name; None if its file is not beside them."""
    files: set[Path] = set()
    for path in paths:
        rows = _rows(path)
        name = re.split(r"[\\/]", rows[1][1].strip())[-1].lower() if len(rows) > 1 else ""
        same_name = [file for file in path.parent.iterdir() if file.name.lower() == name]
        files.update(same_name if name.endswith(".mnd") else ())
    return _mandrel(min(files)) if len(files) == 1 else None


def _mandrel(path: Path) -> list[list[list[float]]]:
    """Return the parts of the mandrel in a mandrel file, each of points, m, from left to right.

    After the head and the number of points, each line has place, radius, number of extra points up
    to the next point, and the radius of an arc up to it. Extra points subdivide a line, which
    becomes a part of its own. Points on the axis are left out.
    """
    rows = _rows(path)
    if not rows or not rows[0][1].strip().upper().startswith(_MANDREL):
        raise JobError(
            f"a mandrel file of CADFIL that turns about an axis begins with {_MANDREL}",
            place=Place(str(path), rows[0][0] if rows else 1),
            remedy="Save an axisymmetric mandrel from CADFIL.",
        )
    if len(rows) < 3:
        raise JobError("it ends within its head", place=Place(str(path)), remedy="Save it again.")
    (_, flag), (number, line) = rows[1:3]
    if flag.split()[0] != "0":
        raise JobError(
            f"the mandrel is drawn by half: its symmetry flag is {flag.split()[0][:20]}",
            place=Place(str(path), rows[1][0]),
            remedy="Choose No Symmetry in CADFIL's mandrel editor, and draw both halves.",
        )
    count = _numbers(path, line.split("(")[0], number, (6,), 1)[0]
    points = rows[3:]
    if not 2 <= count <= _MOST_POINTS or len(points) < count:
        raise JobError(
            f"it states {count:g} points and has {len(points)}",
            place=Place(str(path), number),
            remedy="The file may be truncated: save it again.",
        )
    parts: list[list[list[float]]] = [[]]
    part_ended = False
    for number, line in points[: int(count)]:
        place, radius, extra, arc = _numbers(path, line, number, _MND_WIDTHS, 4)[:4]
        if arc != 0.0:
            raise JobError(
                f"an arc of {arc:g} mm follows the point at x = {place:g} mm: the sign of such a "
                "radius is not described",
                place=Place(str(path), number),
                remedy="Expand the mandrel in CADFIL's mandrel editor (De-parameterise mandrel).",
            )
        if radius < _LEAST_MM:
            continue
        point = [1e-3 * place, 1e-3 * radius]
        if parts[-1] and point[0] <= parts[-1][-1][0]:
            raise JobError(
                f"the mandrel doubles back: x = {place:g} mm follows {1e3 * parts[-1][-1][0]:g} mm",
                place=Place(str(path), number),
                remedy="Draw its points from left to right in CADFIL's mandrel editor.",
            )
        parts[-1].append(point)
        if part_ended or extra > 0.0:
            parts.append([point])
        part_ended = extra > 0.0
    used_parts = [part for part in parts if len(part) > 1]
    if not used_parts:
        raise JobError(
            "the mandrel has fewer than two points off its axis",
            place=Place(str(path), number),
            remedy="Draw its meridian in CADFIL's mandrel editor.",
        )
    return used_parts


def _joined_paths(paths: Sequence[np.ndarray]) -> np.ndarray:
    """Return (n, 3) points of several paths; each adds only points beyond the ends of finer paths.

    A path with more points has nearly none on chords below the mandrel; in CADFIL's joining paths
    such points lie up to some 0.2 mm below it. Points of both would make a jagged mandrel.
    """
    finest, *coarser = sorted(paths, key=len, reverse=True)
    points_seen = finest
    for points in coarser:
        low, high = points_seen[:, 0].min(), points_seen[:, 0].max()
        is_beyond = (points[:, 0] < low) | (points[:, 0] > high)
        points_seen = np.vstack([points_seen, points[is_beyond]])
    return points_seen


def _listed_payouts(path: Path) -> Iterator[Path]:
    """Yield the payout files that a control file lists, which stand beside it."""
    text = read_text(path, _MAX_BYTES, JobError, "control file", "latin-1")
    files = {file.name.lower(): file for file in path.parent.iterdir()}
    listed: set[str] = set()
    for number, line in enumerate(text.splitlines(), start=1):
        for word in _NAME.findall(line):
            name = re.split(r"[\\/]", word)[-1].lower()
            has_ending = name.endswith(".pay")
            file = files.get(name if has_ending else f"{name}.pay")
            if has_ending and file is None:
                raise JobError(
                    f"the payout file {word[:60]!r} is not beside the control file",
                    place=Place(str(path), number),
                    remedy="Copy the payout files into its folder.",
                )
            if file is not None and name not in listed:
                listed.add(name)
                yield file
    if not listed:
        raise JobError(
            "the control file names no payout file (.PAY)",
            place=Place(str(path)),
            remedy="Give a .PAY, or the mandrel as a product file (.wind.toml).",
        )


def _rows(path: Path) -> list[tuple[int, str]]:
    """Return the lines with content, but for settings and notes, with their numbers."""
    text = read_text(path, _MAX_BYTES, JobError, "file of CADFIL", "latin-1")
    return [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.startswith(_NOTE_MARKS)
    ]


def _numbers(path: Path, line: str, number: int, widths: Sequence[int], least: int) -> list[float]:
    """Return the numbers of a line, separated by blanks or by the widths of Fortran's columns."""
    words = line.split()
    if len(words) < least:
        ends = np.cumsum(widths).tolist()
        words = [line[a:b].strip() for a, b in zip([0, *ends[:-1]], ends, strict=True)]
        words = [word for word in words if word]
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) < least or not all(abs(value) <= _MOST_MM for value in numbers):
        raise JobError(
            f"{line.strip()[:60]!r} is not what CADFIL writes here: {least} numbers or more",
            place=Place(str(path), number),
            remedy="Save it again from CADFIL.",
        )
    return numbers


def _width_mm(path: Path) -> float:
    """Return the width of the band in a payout path, or in the one beside a fibre path."""
    if path.suffix.lower() == ".fib":
        same_stem = [file for file in path.parent.iterdir() if file.stem == path.stem]
        payout = next((file for file in same_stem if file.suffix.lower() == ".pay"), None)
        if payout is None:
            raise JobError(
                "a .FIB has no width of the band",
                place=Place(str(path)),
                remedy=f"Put {path.stem}.PAY beside it, or write a product file with [[part]] "
                f'file = "{path.name}" and [band].',
            )
        path = payout
    rows = _rows(path)
    if len(rows) < _PAY_LINES:
        raise JobError("it ends within its head", place=Place(str(path)), remedy="Save it again.")
    number, line = rows[2]
    width = _numbers(path, line, number, (6, 6, 14, 14, 14), 4)[3]
    if not 1e-6 < width < 1e4:
        raise JobError(
            f"the band is {width:g} mm wide", place=Place(str(path), number), remedy="Correct BWID."
        )
    return width


def _cadfil_points(path: Path) -> np.ndarray:
    """Return (n, 3) points of the fibre on the mandrel, mm."""
    rows, payout = _rows(path), path.suffix.lower() == ".pay"
    head, step = (_PAY_LINES, 2) if payout else (_FIB_LINES, 1)
    if len(rows) <= head:
        raise JobError("it ends within its head", place=Place(str(path)), remedy="Save it again.")
    if not payout and len(rows[head - 2][1].split()) == _WITH_COUNT:
        head -= 1
    number, line = rows[head - 1]
    count = _numbers(path, line, number, (6,), 1)[0 if head == _PAY_LINES else 1]
    points = rows[head::step]
    if not 2 <= count <= _MOST_POINTS or len(points) < count:
        raise JobError(
            f"it states {count:g} points and has {len(points)}",
            place=Place(str(path), number),
            remedy="The file may be truncated: save it again.",
        )
    first, widths, least = (0, _PAY_WIDTHS, 6) if payout else (1, _FIB_WIDTHS, 7)
    point_rows = [
        _numbers(path, line, number, widths, least)[first : first + 3]
        for number, line in points[: int(count)]
    ]
    return np.array(point_rows)


def _meridian(points_mm: np.ndarray, path: Path) -> list[list[float]]:
    """Return the meridian under points, left to right; points at one place are averaged."""
    x, r = 1e-3 * points_mm[:, 0], 1e-3 * np.hypot(points_mm[:, 1], points_mm[:, 2])
    order = np.argsort(x, kind="stable")
    x, r = x[order], r[order]
    group = np.concatenate([[0], np.cumsum(np.diff(x) > _SAME_POINT_M)])
    count = np.bincount(group)
    places, radii = np.bincount(group, x) / count, np.bincount(group, r) / count
    if len(places) < 2 or float(radii.min()) <= 0.0:
        raise JobError(
            "its points show no mandrel: they stay at one place, or reach the axis",
            place=Place(str(path)),
            remedy="Give the mandrel as a product file (.wind.toml).",
        )
    return [[float(place), float(radius)] for place, radius in zip(places, radii, strict=True)]
