"""Cache of machine code on disk, by its inputs, shared by processes.

If several processes need the same code, one compiles it and the others wait.
"""

from __future__ import annotations

import hashlib
import os
import uuid
from contextlib import suppress
from pathlib import Path

from threadline.base.compiled import FileLock

_MOST = 512
"""Largest number of files; the least recently used one is removed first."""
_DIGEST_BYTES = 32


class KeptCode:
    """Files of machine code, each preceded by a digest of its bytes.

    A partial or modified file is ignored, because running it would crash.

    Parameters
    ----------
    folder
        Folder of the files; None for no cache.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._making: dict[Path, FileLock] = {}

    def read(self, made_from: str) -> bytes | None:
        """Return the machine code for the inputs ``made_from``; None if the caller must compile it.

        Other processes that need the same code then wait for ``write``.
        """
        if self._folder is None:
            return None
        path = self._path(self._folder, made_from)
        code = self._read(path)
        if code is None and path not in self._making:
            lock = FileLock(path.with_suffix(".lock"))
            code = self._read(path)
            if code is None:
                self._making[path] = lock
        return code

    @staticmethod
    def _read(path: Path) -> bytes | None:
        try:
            data = path.read_bytes()
        except OSError:
            return None
        digest, code = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
        if hashlib.sha256(code).digest() != digest:
            return None
        with suppress(OSError):
            os.utime(path)
        return code

    def write(self, made_from: str, code: bytes) -> None:
        """Write machine code; if that fails, the next process compiles again."""
        if self._folder is None:
            return
        path = self._path(self._folder, made_from)
        part = path.with_suffix(f".{uuid.uuid4().hex[:16]}")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            part.write_bytes(hashlib.sha256(code).digest() + code)
            part.replace(path)
            self._forget(self._folder)
        except OSError:
            return
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)
            lock = self._making.pop(path, None)
            if lock is not None:
                lock.remove()

    @staticmethod
    def _path(folder: Path, made_from: str) -> Path:
        return folder / f"kernel-{hashlib.sha256(made_from.encode()).hexdigest()}.bin"

    @staticmethod
    def _forget(folder: Path) -> None:
        files = list(folder.glob("kernel-*.bin"))
        if len(files) <= _MOST:
            return
        aged = []
        for file in files:
            with suppress(OSError):  # another process may have removed it
                aged.append((file.stat().st_mtime, file))
        for _, file in sorted(aged)[: len(aged) - _MOST]:
            file.unlink(missing_ok=True)
