"""Longer turns on a core for computing tests: processes that share it find cold caches."""

from __future__ import annotations

import ctypes
import os
import platform
import struct
import sys
from contextlib import suppress

_CALLS = {"x86_64": 314, "aarch64": 274}
"""Number of Linux's call ``sched_setattr``; a kernel since 6.12 heeds the turn that it asks for."""
_SIZE, _USUAL_POLICY, _NOT_FOR_CHILDREN = 48, 0, 1
LONG_S = 0.04
"""The turn of a test that computes, s."""


def ask_for_turns(seconds: float) -> bool:
    """Set the length of the calling thread's turns on its core; return whether it is possible.

    Each process still gets the same share of the core, and a waking process with short turns still
    comes in between. Started processes and threads have the usual turns.

    Parameters
    ----------
    seconds
        0 for the usual turns, some milliseconds.
    """
    call = _CALLS.get(platform.machine())
    if sys.platform != "linux" or call is None:
        return False
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    asked = struct.pack(
        "=IIQiIQQQ", _SIZE, _USUAL_POLICY, _NOT_FOR_CHILDREN, nice, 0, round(seconds * 1e9), 0, 0
    )
    with suppress(OSError, AttributeError):
        return bool(ctypes.CDLL(None).syscall(call, 0, asked, 0) == 0)
    return False
