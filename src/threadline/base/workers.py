"""The single place at which a batch is calculated: on this computer, or on a cluster.

A search passes its items to ``answers`` and gets the answers in the order of the items. The bits of
an answer do not depend on the computer that calculated it. ``working_on`` selects the computers:
every batch inside its block goes to the given workers, so that the functions in between need no
argument for them.
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
"""Called with the number of machines judged since the last call; it may be a fraction."""


class Work(Protocol[T_contra, R_co]):
    """Work on items that do not depend on each other.

    Workers get a pickled copy, which must not refer to files of this computer.
    """

    def answer(self, item: T_contra, done: Done | None = None, /) -> R_co:
        """Return the answer to one item; ``done`` counts only the machines of this item."""
        ...

    def machines(self, item: T_contra, /) -> int:
        """Return the number of machines in an item."""
        ...

    def known(self) -> bytes:
        """Return the bits of an answer that every computer must reproduce."""
        ...


class Workers(Protocol):
    """Other processes that answer items, perhaps on other computers."""

    @property
    def cores(self) -> int:
        """Number of items that are answered at the same time; at least 1."""
        ...

    def answers(self, work: Work[T, R], items: Iterable[T], done: Done | None) -> Iterator[R]:
        """Yield the answer to each item, in their order."""
        ...


_WORKERS: ContextVar[Workers | None] = ContextVar("workers", default=None)
_AHEAD = 2  # number of items per thread that are taken before the first answer is read


def workers() -> Workers | None:
    """Return the workers that answer at present; None if this computer answers."""
    return _WORKERS.get()


@contextmanager
def working_on(chosen: Workers) -> Iterator[None]:
    """Let ``chosen`` answer all batches that are started inside the block."""
    token = _WORKERS.set(chosen)
    try:
        yield
    finally:
        _WORKERS.reset(token)


def answers(
    work: Work[T, R],
    items: Iterable[T],
    done: Done | None = None,
    *,
    threads: int = 1,
    here: bool = False,
) -> Iterator[R]:
    """Yield the answer to each item, in their order; items are taken a few at a time.

    If the iterator is closed early, for example by an interrupt, the answers in progress end at
    their next call of ``done``.

    Parameters
    ----------
    done
        Called with the number of machines that were answered since the last call.
    threads
        Number of items that are answered at the same time, if this computer answers them.
    here
        Whether this computer answers in any case, because a single item is not worth sending.

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
        if ended.is_set():  # the rest of this answer is no longer needed
            raise CancelledError
        if done is not None:
            with lock:
                done(count)

    pool = ThreadPoolExecutor(threads)
    waiting: deque[Future[R]] = deque()
    try:
        for item in items:
            # A thread of a pool does not inherit the context, which says to which command progress
            # is reported.
            waiting.append(pool.submit(copy_context().run, work.answer, item, report))
            if len(waiting) >= _AHEAD * threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        ended.set()
        pool.shutdown(wait=True, cancel_futures=True)
