"""The one door through which a batch is calculated: on this computer, or on a cluster.

A search hands its items to ``answers`` and gets the answers in the order of the items, to the same
bits wherever they were calculated. ``working_on`` says where: everything that is asked inside it
goes to the given workers, and no function in between takes an argument for that.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from threading import Event, Lock
from typing import Protocol, TypeVar

T = TypeVar("T")
T_contra = TypeVar("T_contra", contravariant=True)
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)

Done = Callable[[float], None]
"""Called with the number of judged machines since the call before; a part of one counts, too."""


class Work(Protocol[T_contra, R_co]):
    """Work on items that do not depend on each other.

    Workers get a pickled copy, which must not refer to files of this computer.
    """

    def answer(self, item: T_contra, done: Done | None = None, /) -> R_co:
        """Return the answer to one item; ``done`` counts the machines of this item alone."""
        ...

    def machines(self, item: T_contra, /) -> int:
        """Return the number of machines in an item."""
        ...

    def known(self) -> bytes:
        """Return the bits of an answer that every computer must come to."""
        ...


class Workers(Protocol):
    """Other processes that answer items, perhaps on other computers."""

    @property
    def cores(self) -> int:
        """Number of items that are answered at once; at least 1."""
        ...

    def answers(self, work: Work[T, R], items: Iterable[T], done: Done | None) -> Iterator[R]:
        """Yield the answer to each item, in their order."""
        ...


_WORKERS: ContextVar[Workers | None] = ContextVar("workers", default=None)
_AHEAD = 2  # items for each thread that are taken before the first answer is read


def workers() -> Workers | None:
    """Return the workers that answer at present; None for this computer alone."""
    return _WORKERS.get()


@contextmanager
def working_on(chosen: Workers) -> Iterator[None]:
    """Let ``chosen`` answer all batches that are started inside."""
    before = _WORKERS.set(chosen)
    try:
        yield
    finally:
        _WORKERS.reset(before)


def answers(
    work: Work[T, R],
    items: Iterable[T],
    done: Done | None = None,
    *,
    threads: int = 1,
    here: bool = False,
) -> Iterator[R]:
    """Yield the answer to each item, in their order; items are taken a few at a time.

    Closed early, as an interrupt closes it, it ends the answers under way at their next ``done``.

    Parameters
    ----------
    done
        Called with the number of machines that were answered since the call before.
    threads
        Items that are answered at once where this computer answers them.
    here
        Whether this computer answers anyhow, because a single item is not worth sending.

    >>> class Squares:
    ...     def answer(self, item, done=None):
    ...         return item * item
    >>> list(answers(Squares(), range(4), threads=2))
    [0, 1, 4, 9]
    """
    chosen = _WORKERS.get()
    if chosen is not None and not here:
        return chosen.answers(work, items, done)
    if threads == 1:
        return (work.answer(item, done) for item in items)
    return _in_threads(work, items, done, threads)


def _in_threads(
    work: Work[T, R], items: Iterable[T], done: Done | None, threads: int
) -> Iterator[R]:
    lock, ended = Lock(), Event()

    def report(count: float) -> None:
        if ended.is_set():  # nobody waits for the rest of this answer
            raise CancelledError
        if done is not None:
            with lock:
                done(count)

    pool = ThreadPoolExecutor(threads)
    waiting: deque[Future[R]] = deque()
    try:
        for item in items:
            # A thread of a pool has no context of its own: progress is reported to the command
            # that asked.
            waiting.append(pool.submit(copy_context().run, work.answer, item, report))
            if len(waiting) >= _AHEAD * threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        ended.set()
        pool.shutdown(wait=True, cancel_futures=True)
