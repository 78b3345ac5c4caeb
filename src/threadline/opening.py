"""What every reader asks of a path before it opens it."""

from __future__ import annotations

import errno
import stat
from pathlib import Path


def refuse_special(path: Path) -> None:
    """Refuse a pipe, a device or a socket: opening or reading one may never end.

    Raises
    ------
    OSError
        If ``path`` is one of them, or cannot be looked at. A folder passes: opening it fails with
        a reason of its own.
    """
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError(errno.EINVAL, "it is a pipe or a device, not a file", str(path))
