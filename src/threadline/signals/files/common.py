"""Functions that all file formats of commands and recordings share."""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import IO, Annotated, Any, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from threadline.errors import Place, RecordingError, ThreadlineError
from threadline.escaping import json_line
from threadline.foreign_messages import field_fault
from threadline.input_files import KnownFile
from threadline.writing import content_of, staged_file

MAX_LINE_BYTES = 1 << 20
MAX_META_BYTES = 1 << 20
MAX_COUNTS = 2**53
_FRACTION = r"^[0-9]{1,40}/[0-9]{1,40}$"

Counts = Annotated[int, Field(strict=True, ge=-MAX_COUNTS, le=MAX_COUNTS)]
FractionText = Annotated[str, Field(pattern=_FRACTION)]
Label = Annotated[str, Field(min_length=1, max_length=80)]
Hash = Annotated[str, Field(max_length=128)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Written:
    """A file that was written, and its hash.

    ``warnings`` say what was left out or looks suspicious; ``facts`` say what was checked of its
    content. ``as_run_s`` are two times by the planner of a firmware, of the job as it stands and of
    the file; None where the planner is not known.
    """

    path: Path
    sha256: str
    warnings: tuple[str, ...] = ()
    facts: tuple[str, ...] = ()
    as_run_s: tuple[float, float] | None = None


@contextmanager
def atomic_file(path: Path) -> Iterator[IO[bytes]]:
    """Open a file that appears at ``path`` when the block ends well, and not at all otherwise.

    Inside a ``together`` block of ``threadline.writing`` it appears when that block ends. Until
    then its bytes are in the file that the ``name`` of the opened stream gives.

    Raises
    ------
    RecordingError
        If the file cannot be written.
    """
    try:
        with staged_file(path) as file:
            yield file
    except OSError as error:
        raise RecordingError(
            f"cannot write {str(path)!r}: {error.strerror or error}", remedy="Give another file."
        ) from error


def written(path: Path, warnings: tuple[str, ...] = ()) -> Written:
    """Return ``path`` with the hash of what is in it."""
    with content_of(path).open("rb") as file:
        return Written(path, hashlib.file_digest(file, "sha256").hexdigest(), warnings)


@contextmanager
def clear_errors(path: Path) -> Iterator[None]:
    """Turn every error that a broken file causes into a ``RecordingError`` that names the file."""
    try:
        yield
    except ThreadlineError:
        raise
    except UnicodeDecodeError as error:
        raise RecordingError("the file is not UTF-8 text", place=Place(str(path))) from error
    except OSError as error:
        raise RecordingError(
            f"cannot read {str(path)[:200]!r}: {error.strerror or error}",
            remedy="Give a file that can be read.",
        ) from error
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        RuntimeError,
        ValueError,
        OverflowError,
    ) as error:
        raise RecordingError(
            f"the file is damaged: {str(error)[:200] or type(error).__name__}",
            place=Place(str(path)),
            remedy="Write or fetch it again.",
        ) from error


@contextmanager
def reading(known: KnownFile) -> Iterator[None]:
    """Do as ``clear_errors`` while a file is read again, and refuse a file that was changed.

    Raises
    ------
    RecordingError
        If the content is not the one of the first reading.
    """
    with clear_errors(known.path):
        if not known.is_unchanged():
            raise RecordingError(
                f"the file was changed since it was read; its SHA-256 was {known.sha256[:12]}",
                place=Place(str(known.path)),
                remedy="Read it again.",
            )
        yield


def text_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line numbers, from 1, and lines; a RecordingError refuses binary or endless lines."""
    with path.open("rb") as file:
        number = 0
        while raw := file.readline(MAX_LINE_BYTES + 1):
            number += 1
            if len(raw) > MAX_LINE_BYTES:
                raise RecordingError(
                    f"the line is longer than {MAX_LINE_BYTES} bytes",
                    place=Place(str(path), number),
                    remedy="This is not a table.",
                )
            if b"\0" in raw:
                raise RecordingError(
                    "the file is binary, not text",
                    place=Place(str(path), number),
                    remedy="A table begins with a line that names its columns.",
                )
            try:
                text = raw.decode("utf-8-sig" if number == 1 else "utf-8")
            except UnicodeDecodeError as error:
                raise RecordingError(
                    "the line is not UTF-8 text", place=Place(str(path), number)
                ) from error
            yield number, text.rstrip("\r\n")


def meta_lines(title: str, meta: dict[str, Any]) -> Iterator[str]:
    """Yield the comment lines in which text formats keep what is not in their columns."""
    yield f"# threadline {title}"
    for key, value in meta.items():
        yield f"# {key}: {json_line(value)}"


def parse_meta_lines(lines: Iterable[tuple[int, str]], path: Path) -> dict[str, Any]:
    """Return what ``meta_lines`` wrote, from its lines after the title."""
    meta: dict[str, Any] = {}
    for number, line in lines:
        key, colon, value = line.lstrip("# ").partition(":")
        if not colon:
            raise RecordingError(
                f"{line[:80]!r} is not a '# key: value' line", place=Place(str(path), number)
            )
        if key in meta:
            raise RecordingError(f"{key!r} stands twice", place=Place(str(path), number))
        meta[key] = parse_json(value, Place(str(path), number))
    return meta


def parse_json(text: str, place: Place) -> Any:
    """Return the JSON value in ``text``.

    Raises
    ------
    RecordingError
        If it is none.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{text.strip()[:80]!r} is not JSON", place=place) from error


def checked_meta(adapter: TypeAdapter[T], meta: Any, path: Path) -> T:
    """Return ``meta`` as the dataclass of ``adapter``, or say which key is wrong."""
    try:
        return adapter.validate_python(meta)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise RecordingError(
            f"the description in the file is wrong at {where!r}: {field_fault(first)[0]}",
            place=Place(str(path)),
            remedy="Write it again with this version of Threadline.",
        ) from error


def positive_fraction(text: str, place: Place) -> Fraction:
    """Return ``"1/200"`` as a fraction greater than zero."""
    numerator, _, denominator = text.partition("/")
    if int(numerator) == 0 or int(denominator) == 0:
        raise RecordingError(f"the period {text!r} must be greater than zero", place=place)
    return Fraction(int(numerator), int(denominator))


def fraction_text(value: Fraction) -> str:
    """Return a fraction as ``"1/200"``."""
    return f"{value.numerator}/{value.denominator}"
