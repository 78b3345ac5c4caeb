"""NumPy's ``.npz`` format, written and read piece by piece: a column need not fit into memory.

``numpy.load`` can read these files. This module does not use it, because it reads whole arrays and
allocates the size that a header claims without checking it.
"""

from __future__ import annotations

import json
import re
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from threadline.errors import Place, RecordingError
from threadline.files.formats.common import MAX_META_BYTES, parse_json

META = "meta.json"
MAX_MEMBERS = 512
MAX_TOTAL_BYTES = 1 << 40
_MAX_RATIO = 1100  # deflate packs at most 1032 : 1; a header that claims more is wrong
_EPOCH = (1980, 1, 1, 0, 0, 0)  # a fixed date, so that equal content gives equal files
_COPY_BYTES = 1 << 20
_MAX_HEADER = 1000
_HEADER = re.compile(
    r"\{'descr': (?P<descr>[^{}]{1,200}), 'fortran_order': (?P<order>True|False), "
    r"'shape': \((?P<shape>(?:[0-9]{1,18}, ?)*(?:[0-9]{1,18})?)\), \} *\n"
)


class ColumnSpool:
    """Collects columns of unknown length in temporary files, then packs them into one archive.

    Parameters
    ----------
    folder
        Folder of the temporary files.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._stack = ExitStack()
        self._columns: dict[str, tuple[IO[bytes], np.dtype[Any], tuple[int, ...]]] = {}
        self._rows: dict[str, int] = {}

    def __enter__(self) -> ColumnSpool:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def column(self, name: str, dtype: str, width: tuple[int, ...] = ()) -> None:
        """Add an empty column with rows of shape ``width``."""
        file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115  the stack closes it
        self._stack.enter_context(file)
        self._columns[name] = (file, np.dtype(dtype), width)
        self._rows[name] = 0

    def append(self, name: str, values: NDArray[Any]) -> None:
        """Add (n, *width) rows to a column."""
        file, dtype, width = self._columns[name]
        rows = np.ascontiguousarray(values, dtype=dtype).reshape(-1, *width)
        file.write(rows.data)
        self._rows[name] += len(rows)

    def pack(self, file: IO[bytes], meta: dict[str, Any]) -> None:
        """Write the archive: the description first, then every column.

        Raises
        ------
        RecordingError
            If the description is too large.
        """
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            text = json.dumps(meta, ensure_ascii=False, indent=1).encode()
            if len(text) > MAX_META_BYTES:
                raise RecordingError(
                    f"the description needs {len(text)} bytes, limit {MAX_META_BYTES}",
                    remedy="Use fewer names of events.",
                )
            archive.writestr(_info(META), text, zipfile.ZIP_DEFLATED, 1)
            for name, (spool, dtype, width) in self._columns.items():
                header = {
                    "descr": npy.dtype_to_descr(dtype),
                    "fortran_order": False,
                    "shape": (self._rows[name], *width),
                }
                spool.seek(0)
                with archive.open(_info(f"{name}.npy"), "w", force_zip64=True) as member:
                    npy.write_array_header_2_0(member, header)
                    while chunk := spool.read(_COPY_BYTES):
                        member.write(chunk)


def _info(name: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, _EPOCH)
    info.compress_type = zipfile.ZIP_DEFLATED
    info.external_attr = 0o644 << 16
    return info


class ColumnArchive:
    """Reads the columns of an archive, some rows at a time.

    Raises
    ------
    RecordingError
        If the file is not an archive, or its headers claim more data than it can hold.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stack = ExitStack()
        self._archive = self._stack.enter_context(zipfile.ZipFile(path))
        try:
            self._check()
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> ColumnArchive:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _refuse(self, message: str) -> RecordingError:
        return RecordingError(
            message, place=Place(str(self._path)), remedy="Write or fetch the file again."
        )

    def _check(self) -> None:
        infos = self._archive.infolist()
        names = [info.filename for info in infos]
        if len(set(names)) < len(names) or len(names) > MAX_MEMBERS:
            raise self._refuse("the archive has repeated names or too many of them")
        for info in infos:
            if info.compress_type not in {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
                raise self._refuse(f"{info.filename[:60]!r} has an unknown compression")
            if info.flag_bits & 1:
                raise self._refuse(f"{info.filename[:60]!r} is encrypted")
            if info.file_size > _MAX_RATIO * (info.compress_size + 64):
                raise self._refuse(f"{info.filename[:60]!r} promises more than it can hold")
        size = self._path.stat().st_size
        total = sum(info.file_size for info in infos)
        if sum(info.compress_size for info in infos) > size or total > MAX_TOTAL_BYTES:
            raise self._refuse("the archive promises more than it can hold")

    def verify(self) -> None:
        """Read the whole file once and verify its checksums, before any result depends on it.

        Raises
        ------
        RecordingError
            If a checksum is wrong.
        """
        damaged_name = self._archive.testzip()
        if damaged_name is not None:
            raise self._refuse(
                f"the file is damaged: the checksum of {damaged_name[:60]!r} is wrong"
            )

    def meta(self) -> Any:
        """Return the description.

        Raises
        ------
        RecordingError
            If it is missing, too large or not JSON.
        """
        try:
            info = self._archive.getinfo(META)
        except KeyError as error:
            raise RecordingError(
                f"the archive has no {META}",
                place=Place(str(self._path)),
                remedy="Threadline did not write it; give a CSV file with units instead.",
            ) from error
        if info.file_size > MAX_META_BYTES:
            raise self._refuse(f"{META} has {info.file_size} bytes, limit {MAX_META_BYTES}")
        return parse_json(self._archive.read(info).decode(), Place(str(self._path)))

    def column(self, name: str, dtype: str, width: tuple[int, ...] = ()) -> ColumnReader:
        """Open a column and check its type and the shape of its rows.

        Raises
        ------
        RecordingError
            If the column is missing, or its type, shape or size is wrong.
        """
        try:
            info = self._archive.getinfo(f"{name}.npy")
        except KeyError as error:
            raise self._refuse(f"the archive has no column {name!r}") from error
        member = self._stack.enter_context(self._archive.open(info))
        stored_dtype, fortran, shape = self._header(member, name)
        expected = repr(npy.dtype_to_descr(np.dtype(dtype)))
        if stored_dtype != expected:
            raise self._refuse(f"column {name!r} holds {stored_dtype}, expected {expected}")
        if fortran or len(shape) != 1 + len(width) or shape[1:] != width:
            raise self._refuse(f"column {name!r} has shape {shape}, expected (n, {width})")
        row_bytes = np.dtype(dtype).itemsize * int(np.prod(width, dtype=np.int64))
        rows = shape[0]
        if member.tell() + rows * row_bytes != info.file_size:
            raise self._refuse(f"column {name!r} claims {rows} rows but holds a different number")
        return ColumnReader(member, np.dtype(dtype), width, rows)

    def _header(self, member: IO[bytes], name: str) -> tuple[str, bool, tuple[int, ...]]:
        """Return type, order and shape; numpy's reader would run a Python parser on the header."""
        magic = member.read(8)
        size_bytes = {b"\x93NUMPY\x01\x00": 2, b"\x93NUMPY\x02\x00": 4}.get(magic)
        if size_bytes is None:
            raise self._refuse(f"column {name!r} is not an array of a known version")
        size = int.from_bytes(member.read(size_bytes), "little")
        text = member.read(min(size, _MAX_HEADER)).decode("latin-1")
        match = _HEADER.fullmatch(text)
        if match is None or len(text) != size:
            raise self._refuse(f"the header of column {name!r} cannot be read")
        shape = tuple(int(part) for part in match["shape"].split(",") if part.strip())
        return match["descr"], match["order"] == "True", shape


class ColumnReader:
    """An open column; it is read row by row from the start."""

    def __init__(
        self, member: IO[bytes], dtype: np.dtype[Any], width: tuple[int, ...], rows: int
    ) -> None:
        self._member = member
        self._dtype = dtype
        self._width = width
        self.rows = rows
        self._left = rows

    def take(self, count: int) -> NDArray[Any]:
        """Return the next (count, *width) rows, or all remaining rows if they are fewer.

        Raises
        ------
        EOFError
            If the file ends within the column.
        """
        count = min(count, self._left)
        size = count * self._dtype.itemsize * int(np.prod(self._width, dtype=np.int64))
        data = self._member.read(size)
        if len(data) != size:
            raise EOFError("a column ends early")
        self._left -= count
        return np.frombuffer(data, self._dtype).reshape(count, *self._width)

    def runs(self, count: int) -> Iterator[NDArray[Any]]:
        """Yield all remaining rows in arrays (count, *width); the last array may be shorter."""
        while self._left:
            yield self.take(count)
