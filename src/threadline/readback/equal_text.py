"""Comparison of a file on disk with the file that ``compile`` writes, and check of its origin."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from threadline import __version__
from threadline.commands.plan import Plan
from threadline.errors import OptionError, Place, RecordingError
from threadline.readback.equal_found import MOST_BYTES, of_another, refusing

_HEADS = {
    "version": re.compile(r"Written by Threadline (\S+)|\"threadline\": \"([^\"]+)\""),
    "job": re.compile(r"Job \S+, sha256 ([0-9a-f]{16})"),
    "machine file": re.compile(r"Machine \S+, sha256 ([0-9a-f]{16})"),
}
_BESIDE = {
    "st": (".configuration.st",),
    "scl": (".tags.csv", ".alarms.csv", ".hmi.csv"),
    "steps": (
        ".tables.bin", ".tables.csv", ".stitches.bin", ".stitches.csv", ".events.csv",
    ),
}  # fmt: skip
"""Endings of the files that ``compile`` writes beside the named file."""


def check_version(target: str, given: Path, plan: Plan) -> None:
    """Refuse a file that says that it belongs to another version, job or machine file.

    Raises
    ------
    RecordingError
        If the file does so, or is empty.
    OptionError
        If it is larger than any file that ``compile`` writes.
    """
    size = given.stat().st_size
    if size > MOST_BYTES:
        raise OptionError(
            f"{given} has {size / 1e9:.1f} GB, and 1 GB at most is compared",
            remedy="Give a file that compile wrote.",
        )
    if not size:
        raise RecordingError(
            "the file is empty",
            place=Place(str(given)),
            remedy=f"Give a file that compile --target {target} wrote.",
        )
    if target == "npz":
        return
    text = given.read_text(encoding="utf-8", errors="replace")
    wanted = {
        "version": __version__,
        "job": plan.job.sha256[:16],
        "machine file": plan.machine.sha256[:16],
    }
    for what, pattern in _HEADS.items():
        found = pattern.search(text)
        version = next((one for one in found.groups() if one), "") if found else ""
        if version and version != wanted[what]:
            named = "version of Threadline" if what == "version" else what
            raise of_another(named, version, wanted[what], given)


def other_text(target: str, fresh: Path, given: Path) -> str:
    """Describe the first difference of a given file from what ``compile`` writes; empty if none."""
    if target == "npz":
        return _other_arrays(fresh, given)
    difference = _other_lines(fresh, given)
    for ending in _BESIDE.get(target, ()):
        own, other = (path.with_name(f"{path.stem}{ending}") for path in (fresh, given))
        if not difference and other.is_file() and own.read_bytes() != other.read_bytes():
            difference = (
                _other_lines(own, other) if ending.endswith(("csv", "st")) else "other bytes"
            )
            difference = f"{other.name}: {difference or 'other blanks'}"
    return difference


def _other_lines(fresh: Path, given: Path) -> str:
    wanted, found = (_lines(path) for path in (fresh, given))
    for (_, text), (number, other) in zip(wanted, found, strict=False):
        if text != other:
            at = next((k for k, (a, b) in enumerate(zip(text, other, strict=False)) if a != b), 0)
            begin = max(0, at - 20) if len(other) > 40 else 0
            shown = [f"{one[begin : begin + 40]!r}" for one in (other, text)]
            return f"line {number} is {shown[0]}, compile writes {shown[1]}"
    if len(wanted) != len(found):
        return f"{len(found)} lines, compile writes {len(wanted)}"
    return ""


def _lines(path: Path) -> list[tuple[int, str]]:
    """Return the numbered lines of a file that are not empty, without blanks at their ends.

    Only a line feed ends a line, as for a controller: a vertical tab or a next-line character in
    its place is a difference.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"the file is no text: {error.reason} at byte {error.start}",
            place=Place(str(path)),
            remedy="Give a file that compile wrote.",
        ) from error
    found = ((k, line.strip(" \t")) for k, line in enumerate(text.split("\n"), 1))
    return [(k, line) for k, line in found if line]


def _other_arrays(fresh: Path, given: Path) -> str:
    """Describe the first array that differs between two archives, or the first byte.

    An archive that is packed in another way has another size, and is accepted. In an archive of the
    same size every byte must be equal, because no checksum covers dates, sizes and attributes of
    its members.
    """
    with (
        refusing("archive of arrays", "npz", given),
        np.load(fresh) as wanted,
        np.load(given) as found,
    ):
        for name in wanted.files:
            if name not in found.files or not np.array_equal(wanted[name], found[name]):
                return f"{name} is not as compile writes it"
        if more := [name for name in found.files if name not in wanted.files]:
            return f"{more[0][:40]!r} is not in what compile writes"
    own, other = fresh.read_bytes(), given.read_bytes()
    if len(own) == len(other) and own != other:
        at = next(k for k, (a, b) in enumerate(zip(own, other, strict=True)) if a != b)
        return f"byte {at} of the archive is {other[at]:#04x}, compile writes {own[at]:#04x}"
    return ""
