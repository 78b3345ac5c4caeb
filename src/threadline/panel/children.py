"""Processes that answer one request of the panel: they are ended when nobody waits any more."""

from __future__ import annotations

import asyncio
from contextlib import suppress


async def answer_of(
    *words: str, sent: bytes = b"", longest_s: float | None = None
) -> tuple[int, bytes, bytes]:
    """Return the exit status of a process, and what it wrote on its outputs.

    It is killed where its time is over, and where the request or the panel ends before it: work in
    a thread could not be, and the panel would have to wait for it.

    Parameters
    ----------
    words
        The program and its arguments.
    sent
        What it is sent on its standard input.
    longest_s
        Time in s that it may take; None for any.

    Raises
    ------
    TimeoutError
        If it takes longer.
    """
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        *words, stdin=pipe, stdout=pipe, stderr=pipe, start_new_session=True
    )
    try:
        async with asyncio.timeout(longest_s):
            told, why = await process.communicate(sent)
    finally:
        if process.returncode is None:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()
    return process.returncode or 0, told, why
