"""Workers on other computers, by the scheduler of ``distributed``.

Every task names the work by a digest, and depends on one small task that holds the pickled work.
The scheduler can therefore make a lost copy of the work again, which it cannot do with data that a
client scattered. A worker keeps the work ready between tasks, so that
it plans and compiles once.

A worker is refused, by its name, if its versions differ, or if it comes to other bits for the same
machine. An answer is taken in the order of the items, so that it does not depend on which worker
was quick.
"""

from __future__ import annotations

import hashlib
import logging
import pickle
import platform
import threading
import time
import warnings
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

from threadline import __version__
from threadline.base.cluster_address import parse_cluster
from threadline.base.workers import Done, Work, working_on
from threadline.errors import LinkFaultError, OptionError, ThreadlineError

T = TypeVar("T")
R = TypeVar("R")

CONNECT_S = 10.0
"""Longest wait for the scheduler."""
FIRST_S, WORKER_S = 900.0, 60.0
"""Longest wait for the first worker, which a batch system may begin late; and without any later."""
_LOOK_S = 0.5  # how often the workers are counted while an answer is awaited
_AHEAD = 4  # tasks on their way for each core
_LEAST_AHEAD = 16
_KEPT = 8  # works that a worker keeps ready
_ENGINES = ("numpy", "scipy", "numba", "llvmlite")
_RESUME = "What was finished is in the file of --resume, if there is one: repeat the command."


def versions() -> dict[str, str]:
    """Return what the bits of an answer depend on: versions, and a digest of Threadline's source.

    >>> versions()["numpy"] == version("numpy")
    True
    """
    return {
        "Threadline": f"{__version__}, source {_source()}",
        "Python": ".".join(platform.python_version_tuple()[:2]),
        **{name: _version(name) for name in _ENGINES},
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


@cache
def _source() -> str:
    """Return a digest of the package's own files."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        digest.update(file.relative_to(root).as_posix().encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """Why a worker gives no answer."""

    worker: str
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _Answer:
    """An answer, the worker that gave it, and the bits that this worker comes to."""

    worker: str
    known: bytes
    answer: Any


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ready:
    """A work that a worker has ready, and the bits of the answer that is known."""

    work: Work[Any, Any]
    known: bytes


_ready: OrderedDict[str, _Ready] = OrderedDict()
_preparing = threading.Lock()


def same(content: bytes) -> bytes:
    """Return the content: the task on which the others depend."""
    return content


def answer_on_worker(
    content: bytes, digest: str, wanted: Mapping[str, str], item: Any
) -> _Answer | Refusal:
    """Return the answer to one item; this runs on a worker.

    Parameters
    ----------
    content
        The pickled work.
    digest
        Its name.
    wanted
        Versions that the worker must have.
    """
    from distributed import get_worker

    worker = str(get_worker().address)
    if other := _other_versions(versions(), wanted):
        return Refusal(worker=worker, why=other)
    try:
        ready = _prepared(content, digest)
        return _Answer(worker=worker, known=ready.known, answer=ready.work.answer(item))
    except OSError as error:
        what = f"{error.strerror or error}: {error.filename}" if error.filename else str(error)
        return Refusal(worker=worker, why=f"cannot read what the job needs: {what}")


def _prepared(content: bytes, digest: str) -> _Ready:
    """Return a work that is ready; threads of one worker prepare it once."""
    with _preparing:
        if digest not in _ready:
            work = pickle.loads(content)  # noqa: S301 - the scheduler runs whatever it is sent
            _ready[digest] = _Ready(work=work, known=work.known())
            while len(_ready) > _KEPT:
                _ready.popitem(last=False)
        _ready.move_to_end(digest)
        return _ready[digest]


def _other_versions(here: Mapping[str, str], wanted: Mapping[str, str]) -> str:
    """Return in words which versions differ; empty if none does."""
    other = [
        f"{name} {here.get(name, 'none')} instead of {told}"
        for name, told in wanted.items()
        if here.get(name) != told
    ]
    return f"has {', '.join(other)}" if other else ""


class Cluster:
    """The workers of a scheduler, as ``threadline.base.workers`` asks them.

    Parameters
    ----------
    address
        The scheduler, as ``parse_cluster`` gives it.

    Raises
    ------
    OptionError
        If ``distributed`` is not installed, no certificates are set for TLS, or a worker has other
        versions.
    LinkFaultError
        If the scheduler cannot be reached, or no worker joins it.
    """

    _versions_there = staticmethod(versions)

    def __init__(self, address: str) -> None:
        self.address = address
        self._wanted = versions()
        self._client = _connected(address)
        self._seen_s = time.monotonic()
        self._counted_s = -float("inf")
        self._cores, self._met = 0, False
        self._works: dict[int, tuple[Work[Any, Any], str, Any]] = {}
        self._known: dict[str, bytes] = {}
        try:
            self._await_worker()
            self._check_versions()
        except BaseException:
            self.close()
            raise

    @property
    def cores(self) -> int:
        """Number of items that are answered at once: threads of all workers, at least 1."""
        self._count()
        return max(self._cores, 1)

    @property
    def words(self) -> str:
        """The cluster in words, for a message."""
        count = len(self._nthreads())
        return f"{count} worker{'s' * (count != 1)}, {self.cores} at once, of {self.address}"

    def close(self) -> None:
        """Give up all tasks and the connection; workers and scheduler go on."""
        with suppress(Exception), _quiet():
            self._client.close(timeout=2)

    def answers(self, work: Work[T, R], items: Iterable[T], done: Done | None) -> Iterator[R]:
        """Yield the answer to each item, in their order.

        Raises
        ------
        OptionError
            If a worker has other versions.
        LinkFaultError
            If the cluster fails, or a worker comes to other bits.
        """
        digest, content = self._sent(work)
        waiting: deque[tuple[Any, T]] = deque()
        given = iter(items)
        more = True
        try:
            while more or waiting:
                most = max(_AHEAD * self.cores, _LEAST_AHEAD)
                while more and len(waiting) < most:
                    try:
                        item = next(given)
                    except StopIteration:
                        more = False
                        break
                    waiting.append((self._begun(content, digest, item), item))
                if not waiting:
                    break
                try:
                    found = self._awaited(waiting[0][0])
                except CancelledError:  # the scheduler was away, and is back: it knows nothing
                    self._works.clear()
                    digest, content = self._sent(work)
                    again = [(self._begun(content, digest, item), item) for _, item in waiting]
                    waiting = deque(again)
                    continue
                future, item = waiting.popleft()
                future.release()
                self._check_bits(found, digest)
                if done is not None:
                    done(work.machines(item))
                yield found.answer
        finally:
            for future, _ in waiting:  # the scheduler forgets what nobody waits for
                with suppress(Exception):
                    future.release()

    def _sent(self, work: Work[Any, Any]) -> tuple[str, Any]:
        """Return the name of a work, and the task that holds it; each work is sent once."""
        if id(work) not in self._works:
            content = pickle.dumps(work, protocol=5)
            digest = hashlib.sha256(content).hexdigest()
            with self._failing(), _quiet():
                key = f"threadline-work-{digest}"
                future = self._client.submit(same, content, key=key)
            self._works[id(work)] = work, digest, future  # the work stays, and so does its id
            while len(self._works) > _KEPT:
                del self._works[next(iter(self._works))]
        _, digest, future = self._works[id(work)]
        if digest not in self._known:
            self._known[digest] = work.known()
        return digest, future

    def _begun(self, content: Any, digest: str, item: Any) -> Any:
        with self._failing(), _quiet():
            return self._client.submit(
                answer_on_worker, content, digest, self._wanted, item, pure=False
            )

    def _awaited(self, future: Any) -> _Answer:
        """Return the answer of a task, while there is a scheduler and a worker to wait for."""
        while True:
            with self._failing():
                found = _result(future)
            if isinstance(found, Refusal):
                raise self._refused(found.worker, found.why)
            if found is not None:
                self._seen_s = time.monotonic()
                return found
            self._count()

    def _check_bits(self, found: _Answer, digest: str) -> None:
        if found.known != self._known[digest]:
            raise LinkFaultError(
                f"worker {found.worker} of --cluster {self.address} comes to other bits than this "
                "computer for the machine as its file says",
                remedy="Its processor has other instructions: give workers of one kind, or let "
                "all of them use the same (NPY_DISABLE_CPU_FEATURES, OPENBLAS_CORETYPE). "
                f"{_RESUME}",
            )

    def _check_versions(self) -> None:
        """Refuse workers of other versions before anything is planned."""
        with self._failing(), _quiet():
            told = self._client.run(self._versions_there, on_error="return")
        for worker, found in told.items():
            if isinstance(found, ModuleNotFoundError):
                raise self._refused(worker, f"has no {found.name}")
            if isinstance(found, Exception):
                raise self._refused(worker, f"cannot tell its versions: {found}")
            if other := _other_versions(found, self._wanted):
                raise self._refused(worker, other)

    def _refused(self, worker: str, why: str) -> OptionError:
        return OptionError(
            f"worker {worker} of --cluster {self.address} {why}",
            remedy="Install the same versions on every worker and start it again: pip install "
            "--require-hashes -r requirements/cluster.txt, then pip install --no-deps . "
            "(Threadline itself)."
            if why.startswith("has ")
            else "Put the files at the same place on every worker.",
        )

    def _nthreads(self) -> dict[str, int]:
        with self._failing(), _quiet():
            return dict(self._client.nthreads())

    def _count(self) -> None:
        """Count the workers from time to time, and fail if there has been none for long."""
        now_s = time.monotonic()
        if now_s - self._counted_s < _LOOK_S:
            return
        self._counted_s = now_s
        # A scheduler that is away is noticed where an answer is awaited.
        if self._client.status == "running":
            with suppress(CancelledError, LinkFaultError):
                self._cores = sum(self._nthreads().values())
                if self._cores:
                    self._seen_s, self._met = now_s, True
                    return
        most_s = WORKER_S if self._met else FIRST_S
        if now_s - self._seen_s > most_s:
            raise LinkFaultError(
                f"--cluster {self.address} has had no worker for {most_s:g} s",
                remedy=f"Start workers: dask worker {self.address} --nthreads 1. {_RESUME}",
            )

    def _await_worker(self) -> None:
        self._count()
        while not self._cores:
            time.sleep(_LOOK_S)
            self._count()

    @contextmanager
    def _failing(self) -> Iterator[None]:
        """Turn the failures of a cluster into one line each."""
        from distributed.scheduler import KilledWorker

        try:
            yield
        except ThreadlineError:
            raise
        except KilledWorker as error:
            last = getattr(error.last_worker, "address", "one of them")
            raise LinkFaultError(
                f"workers of --cluster {self.address} ended {error.allowed_failures + 1} times "
                f"while they judged the same machines, the last time {last}",
                remedy="Were they killed for their memory? Give each worker more, or fewer "
                f"threads. {_RESUME}",
            ) from error
        except (CancelledError, OSError, RuntimeError, ValueError) as error:
            lost = isinstance(error, CancelledError | OSError)
            if not lost and self._client.status == "running":
                raise  # of a task
            if isinstance(error, CancelledError) and self._is_back():
                raise
            why = " ".join(f"{type(error).__name__} {error}".split())[:160]
            raise LinkFaultError(
                f"the scheduler of --cluster {self.address} went away ({why})",
                remedy=f"Start it and its workers again. {_RESUME}",
            ) from error

    def _is_back(self) -> bool:
        """Return whether the scheduler is there again in a moment."""
        end_s = time.monotonic() + CONNECT_S
        while time.monotonic() < end_s and self._client.status == "connecting":
            time.sleep(_LOOK_S)
        return bool(self._client.status == "running")


def _connected(address: str) -> Any:
    """Return a client of the scheduler."""
    try:
        import distributed
    except ImportError as error:
        raise OptionError(
            "--cluster needs the package distributed, and it is not installed",
            remedy='Install it: pip install "threadline[cluster]".',
        ) from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    of: Any = distributed  # its constructors have no types
    security = None
    if address.startswith("tls://"):
        security = of.Security(require_encryption=True)
        if security.tls_ca_file is None or security.tls_client_cert is None:
            raise OptionError(
                f"--cluster {address} has no certificates",
                remedy="Set DASK_DISTRIBUTED__COMM__TLS__CA_FILE, "
                "DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT and "
                "DASK_DISTRIBUTED__COMM__TLS__CLIENT__KEY (docs/cluster.md).",
            )
    try:
        with _quiet():
            return of.Client(address, timeout=CONNECT_S, security=security, set_as_default=False)
    except (OSError, RuntimeError, ValueError, TypeError, EOFError) as error:
        why = " ".join(str(error).split())[:160]
        raise LinkFaultError(
            f"--cluster {address} cannot be reached: {why}",
            remedy="Start it: dask scheduler --host 127.0.0.1.",
        ) from error


def _result(future: Any) -> _Answer | Refusal | None:
    """Return what a task came to; None if it is still on its way after a moment."""
    try:
        with _quiet():
            return future.result(timeout=_LOOK_S)  # type: ignore[no-any-return]
    except TimeoutError:
        return None


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the warnings of ``distributed`` from the terminal: what matters here is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def on_cluster(address: str | None, tell: Callable[[str], None]) -> Iterator[None]:
    """Let a cluster answer all batches inside; None for this computer.

    Parameters
    ----------
    tell
        Called with the cluster in words.

    Raises
    ------
    OptionError, LinkFaultError
        If the address, its scheduler or a worker cannot be used.
    """
    if address is None:
        yield
        return
    cluster = Cluster(parse_cluster(address))
    try:
        tell(cluster.words)
        with working_on(cluster):
            yield
    finally:
        cluster.close()
