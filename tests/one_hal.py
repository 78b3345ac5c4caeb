"""LinuxCNC's HAL runs once on a computer: its memory has the same keys for everybody."""

from __future__ import annotations

import fcntl
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_LOCK = Path(tempfile.gettempdir()) / "threadline-test-hal.lock"


@contextmanager
def one_hal() -> Iterator[None]:
    """Reserve HAL for one test; others wait."""
    with _LOCK.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
