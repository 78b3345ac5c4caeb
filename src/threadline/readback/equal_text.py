"""Comparison of a file on disk with the file that ``compile`` writes, and check of its origin."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from threadline import __version__
from threadline.commands.plan import Plan
from threadline.errors import OptionError, Place, RecordingError
from threadline.readback.equal_found import MOST_BYTES, of_another, refusing

_ORIGIN_PATTERNS = {
    "version": re.compile(r"Written by Threadline (\S+)|\"threadline\": \"([^\"]+)\""),
    "job": re.compile(r"Job \S+, sha256 ([0-9a-f]{16})"),
    "machine file": re.compile(r"Machine \S+, sha256 ([0-9a-f]{16})"),
}
_ENDINGS_BESIDE = {
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
    expected = {
        "version": __version__,
        "job": plan.job.sha256[:16],
        "machine file": plan.machine.sha256[:16],
    }
    for kind, pattern in _ORIGIN_PATTERNS.items():
        match = pattern.search(text)
        version = next((group for group in match.groups() if group), "") if match else ""
        if version and version != expected[kind]:
            kind_text = "version of Threadline" if kind == "version" else kind
            raise of_another(kind_text, version, expected[kind], given)


def other_text(target: str, fresh: Path, given: Path) -> str:
    """Describe the first difference of a given file from what ``compile`` writes; empty if none."""
    if target == "npz":
        return _other_arrays(fresh, given)
    difference = _other_lines(fresh, given)
    for ending in _ENDINGS_BESIDE.get(target, ()):
        written_file, given_file = (
            path.with_name(f"{path.stem}{ending}") for path in (fresh, given)
        )
        if (
            not difference
            and given_file.is_file()
            and written_file.read_bytes() != given_file.read_bytes()
        ):
            difference = (
                _other_lines(written_file, given_file)
                if ending.endswith(("csv", "st"))
                else "other bytes"
            )
            difference = f"{given_file.name}: {difference or 'other blanks'}"
    return difference


def _other_lines(fresh: Path, given: Path) -> str:
    written_lines, given_lines = (_lines(path) for path in (fresh, given))
    for (_, text), (number, other) in zip(written_lines, given_lines, strict=False):
        if text != other:
            column = next(
                (k for k, (a, b) in enumerate(zip(text, other, strict=False)) if a != b), 0
            )
            begin = max(0, column - 20) if len(other) > 40 else 0
            shown = [f"{text_shown[begin : begin + 40]!r}" for text_shown in (other, text)]
            return f"line {number} is {shown[0]}, compile writes {shown[1]}"
    if len(written_lines) != len(given_lines):
        return f"{len(given_lines)} lines, compile writes {len(written_lines)}"
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
    stripped = ((k, line.strip(" \t")) for k, line in enumerate(text.split("\n"), 1))
    return [(k, line) for k, line in stripped if line]


def _other_arrays(fresh: Path, given: Path) -> str:
    """Describe the first array that differs between two archives, or the first byte.

    An archive that is packed in another way has another size, and is accepted. In an archive of the
    same size every byte must be equal, because no checksum covers dates, sizes and attributes of
    its members.
    """
    with (
        refusing("archive of arrays", "npz", given),
        np.load(fresh) as written,
        np.load(given) as arrays_given,
    ):
        for name in written.files:
            if name not in arrays_given.files or not np.array_equal(
                written[name], arrays_given[name]
            ):
                return f"{name} is not as compile writes it"
        if additional := [name for name in arrays_given.files if name not in written.files]:
            return f"{additional[0][:40]!r} is not in what compile writes"
    written_bytes, given_bytes = fresh.read_bytes(), given.read_bytes()
    if len(written_bytes) == len(given_bytes) and written_bytes != given_bytes:
        offset = next(
            k for k, (a, b) in enumerate(zip(written_bytes, given_bytes, strict=True)) if a != b
        )
        return (
            f"byte {offset} of the archive is {given_bytes[offset]:#04x}, compile writes "
            f"{written_bytes[offset]:#04x}"
        )
    return ""
