"""Workers on other computers, through the scheduler of ``distributed``.

Every task names its work by a digest, and depends on one small task that holds the pickled work.
The scheduler can therefore make a lost copy of the work again. With data that a client scattered it
could not. A worker keeps the work ready between tasks, so that it plans and compiles only once.

Sending a task and fetching its answer takes some 10 ms of processor time on the client, the
scheduler and the worker together, for any task. A task therefore has so many items that a worker
needs about a second for them; the time per item is measured. The last tasks have fewer items, so
that all workers end at about the same time.

A worker is refused, by its name, if its versions differ, or if its result for the same machine
differs in a bit. Answers are taken in the order of the items, so that the result does not depend on
which worker was faster.
"""

from __future__ import annotations

import hashlib
import ipaddress
import logging
import pickle
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from itertools import islice
from typing import Any, TypeVar

from threadline.base.cluster_worker import (
    MOST_WORKS,
    Answer,
    Refusal,
    answer_on_worker,
    other_versions,
    same,
    versions,
)
from threadline.base.workers import Done, Work, working_on
from threadline.errors import LinkFaultError, OptionError, ThreadlineError

T = TypeVar("T")
R = TypeVar("R")

CONNECT_S = 10.0
"""Longest wait for the scheduler."""
FIRST_S, WORKER_S = 900.0, 60.0
"""Longest wait for the first worker, which a batch system may start late; and longest time without
any worker later."""
_LOOK_S = 0.5  # interval at which the workers are counted while an answer is awaited
TASK_S = 1.0
"""Approximate time that a worker needs for the items of one task."""
_AHEAD = 4  # number of tasks that are sent ahead for each core
_LEAST_AHEAD = 16
_LAST = 3  # the last items are divided into so many tasks for each core
_RESUME = "What was finished is in the file of --resume, if there is one: repeat the command."


def parse_cluster(text: str) -> str:
    """Return the address of a scheduler, which must be on this computer or use TLS.

    >>> parse_cluster("localhost:8786"), parse_cluster("tls://lab.example:8786")
    ('tcp://localhost:8786', 'tls://lab.example:8786')

    Raises
    ------
    OptionError
        If the text is not an address, or is the address of another computer without TLS.
    """
    protocol, _, address = text.strip().rpartition("://")
    protocol = protocol or "tcp"
    host, _, port = address.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    port_number = int(port[:9]) if port.isascii() and port.isdigit() else 0
    if protocol not in {"tcp", "tls"} or not host or not 1 <= port_number <= 65535:
        raise OptionError(
            f"--cluster {text[:80]!r} is no address of a scheduler",
            remedy='Write it like "localhost:8786", or "tls://HOST:8786" for another computer.',
        )
    if protocol == "tcp" and not _on_this_computer(host):
        raise OptionError(
            f"--cluster {text[:80]!r} is another computer, without encryption: a scheduler runs "
            "any code that it is sent",
            remedy=f'Start the scheduler with TLS, and write "tls://{address}".',
        )
    return f"{protocol}://{address}"


def _on_this_computer(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def items_at_once(item_s: float, left: int, cores: int) -> int:
    """Return how many items are sent as one task.

    Parameters
    ----------
    item_s
        Time that a worker needs for one item.
    left
        Number of remaining items, as far as they are known.
    cores
        Number of tasks that are worked on at the same time.

    >>> [items_at_once(0.1, left, 2) for left in (1000, 60, 30, 6, 1)]
    [10, 10, 5, 1, 1]
    """
    return max(min(int(TASK_S / max(item_s, 1e-4)), left // (_LAST * cores)), 1)


class Cluster:
    """The workers of a scheduler, an implementation of ``threadline.base.workers.Workers``.

    Parameters
    ----------
    address
        Address of the scheduler, as ``parse_cluster`` returns it.
    ahead
        Number of tasks that are sent before the answer to the first of them is read; the answers do
        not depend on it. None: four for each core, at least 16.

    Raises
    ------
    OptionError
        If ``distributed`` is not installed, no certificates are set for TLS, or a worker has other
        versions.
    LinkFaultError
        If the scheduler cannot be reached, or has no worker for too long.
    """

    _versions_there = staticmethod(versions)

    def __init__(self, address: str, *, ahead: int | None = None) -> None:
        self.address = address
        self._ahead = ahead
        self._expected_versions = versions()
        self._client = _connected(address)
        self._seen_s = time.monotonic()
        self._counted_s = -float("inf")
        self._cores, self._met = 0, False
        self._works: dict[int, tuple[Work[Any, Any], str, Any]] = {}
        self._known: dict[str, bytes] = {}
        self._item_s: dict[str, float] = {}
        try:
            self._await_worker()
            self._check_versions()
        except BaseException:
            self.close()
            raise

    @property
    def cores(self) -> int:
        """Number of items answered at the same time: threads of all workers, at least 1."""
        self._count()
        return max(self._cores, 1)

    @property
    def words(self) -> str:
        """Description of the cluster, for a message."""
        count = len(self._nthreads())
        return f"{count} worker{'s' * (count != 1)}, {self.cores} at once, of {self.address}"

    def close(self) -> None:
        """Give up all tasks and close the connection; workers and scheduler keep running."""
        with suppress(Exception), _quiet():
            self._client.close(timeout=2)

    def answers(self, work: Work[T, R], items: Iterable[T], done: Done | None) -> Iterator[R]:
        """Yield the answer to each item, in their order.

        Raises
        ------
        OptionError
            If a worker has other versions, or cannot read a file of the job.
        LinkFaultError
            If the cluster fails, or the result of a worker differs in a bit.
        """
        digest, content = self._sent(work)
        waiting: deque[tuple[Any, list[T]]] = deque()
        item_iterator, taken_items = iter(items), deque[T]()
        try:
            while True:
                max_tasks = self._ahead or max(_AHEAD * self.cores, _LEAST_AHEAD)
                while len(waiting) < max_tasks and (
                    task := self._task(item_iterator, taken_items, digest)
                ):
                    waiting.append((self._begun(content, digest, task), task))
                if not waiting:
                    break
                try:
                    task_answer = self._awaited(waiting[0][0])
                except CancelledError:  # the scheduler was restarted and has lost all tasks
                    self._works.clear()
                    digest, content = self._sent(work)
                    resubmitted = [
                        (self._begun(content, digest, task), task) for _, task in waiting
                    ]
                    waiting = deque(resubmitted)
                    continue
                future, task = waiting.popleft()
                future.release()
                self._check_bits(task_answer, digest)
                previous_item_s = self._item_s.get(digest, task_answer.item_s)
                # The first task also loads machine code, so later tasks count more.
                self._item_s[digest] = 0.5 * (previous_item_s + task_answer.item_s)
                for item, answer in zip(task, task_answer.answers, strict=True):
                    if done is not None:
                        done(work.machines(item))
                    yield answer
        finally:
            for future, _ in waiting:  # the scheduler drops released tasks
                with suppress(Exception):
                    future.release()

    def _sent(self, work: Work[Any, Any]) -> tuple[str, Any]:
        """Return the digest of a work, and the task that holds the work; it is sent only once."""
        if id(work) not in self._works:
            content = pickle.dumps(work, protocol=5)
            digest = hashlib.sha256(content).hexdigest()
            with self._failing(), _quiet():
                key = f"threadline-work-{digest}"
                future = self._client.submit(same, content, key=key)
            self._works[id(work)] = work, digest, future  # the reference keeps the id valid
            while len(self._works) > MOST_WORKS:
                del self._works[next(iter(self._works))]
        _, digest, future = self._works[id(work)]
        if digest not in self._known:
            self._known[digest] = work.known()
        return digest, future

    def _task(self, item_iterator: Iterator[T], taken_items: deque[T], digest: str) -> list[T]:
        """Return the items of the next task, none at the end; ``taken_items`` were taken before."""
        item_s = self._item_s.get(digest, TASK_S)
        missing_count = _LAST * self.cores * int(TASK_S / max(item_s, 1e-4)) - len(taken_items)
        taken_items.extend(islice(item_iterator, max(missing_count, 1 - len(taken_items), 0)))
        count = min(items_at_once(item_s, len(taken_items), self.cores), len(taken_items))
        return [taken_items.popleft() for _ in range(count)]

    def _begun(self, content: Any, digest: str, items: list[Any]) -> Any:
        with self._failing(), _quiet():
            return self._client.submit(
                answer_on_worker, content, digest, self._expected_versions, items, pure=False
            )

    def _awaited(self, future: Any) -> Answer:
        """Return the answer of a task; fail if the scheduler is lost or no worker remains."""
        while True:
            with self._failing():
                result = _result(future)
            if isinstance(result, Refusal):
                raise self._refused(result.worker, result.why)
            if result is not None:
                self._seen_s = time.monotonic()
                return result
            self._count()

    def _check_bits(self, answer: Answer, digest: str) -> None:
        if answer.known != self._known[digest]:
            raise LinkFaultError(
                f"worker {answer.worker} of --cluster {self.address} gets other bits than this "
                "computer for the machine of the file",
                remedy="Its processor has other instructions: give workers of one kind, or let "
                "all of them use the same (NPY_DISABLE_CPU_FEATURES, OPENBLAS_CORETYPE). "
                f"{_RESUME}",
            )

    def _check_versions(self) -> None:
        """Refuse workers of other versions before anything is planned."""
        with self._failing(), _quiet():
            versions_by_worker = self._client.run(self._versions_there, on_error="return")
        for worker, worker_versions in versions_by_worker.items():
            if isinstance(worker_versions, ModuleNotFoundError):
                raise self._refused(worker, f"has no {worker_versions.name}")
            if isinstance(worker_versions, Exception):
                raise self._refused(worker, f"cannot tell its versions: {worker_versions}")
            if difference := other_versions(worker_versions, self._expected_versions):
                raise self._refused(worker, difference)

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
        """Count the workers from time to time; fail if there has been none for too long."""
        now_s = time.monotonic()
        if now_s - self._counted_s < _LOOK_S:
            return
        self._counted_s = now_s
        # A lost scheduler is noticed while an answer is awaited.
        if self._client.status == "running":
            with suppress(CancelledError, LinkFaultError):
                self._cores = sum(self._nthreads().values())
                if self._cores:
                    self._seen_s, self._met = now_s, True
                    return
        timeout_s = WORKER_S if self._met else FIRST_S
        if now_s - self._seen_s > timeout_s:
            raise LinkFaultError(
                f"--cluster {self.address} has had no worker for {timeout_s:g} s",
                remedy=f"Start workers: dask worker {self.address} --nthreads 1. {_RESUME}",
            )

    def _await_worker(self) -> None:
        self._count()
        while not self._cores:
            time.sleep(_LOOK_S)
            self._count()

    @contextmanager
    def _failing(self) -> Iterator[None]:
        """Turn each failure of a cluster into an error with a message of one line."""
        from distributed.scheduler import KilledWorker

        try:
            yield
        except ThreadlineError:
            raise
        except KilledWorker as error:
            last_worker = getattr(error.last_worker, "address", "one of them")
            raise LinkFaultError(
                f"workers of --cluster {self.address} ended {error.allowed_failures + 1} times "
                f"while they judged the same machines, the last time {last_worker}",
                remedy="Were they killed for their memory? Give each worker more, or fewer "
                f"threads. {_RESUME}",
            ) from error
        except (CancelledError, OSError, RuntimeError, ValueError) as error:
            is_connection_error = isinstance(error, CancelledError | OSError)
            if not is_connection_error and self._client.status == "running":
                raise  # of a task
            if isinstance(error, CancelledError) and self._is_back():
                raise
            why = " ".join(f"{type(error).__name__} {error}".split())[:160]
            raise LinkFaultError(
                f"the scheduler of --cluster {self.address} went away ({why})",
                remedy=f"Start it and its workers again. {_RESUME}",
            ) from error

    def _is_back(self) -> bool:
        """Return whether the scheduler can be reached again after a moment."""
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
    for name in [*logging.root.manager.loggerDict]:  # several loggers have a level of their own
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)
    untyped_distributed: Any = distributed  # its constructors have no types
    security = None
    if address.startswith("tls://"):
        security = untyped_distributed.Security(require_encryption=True)
        if security.tls_ca_file is None or security.tls_client_cert is None:
            raise OptionError(
                f"--cluster {address} has no certificates",
                remedy="Set DASK_DISTRIBUTED__COMM__TLS__CA_FILE, "
                "DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT and "
                "DASK_DISTRIBUTED__COMM__TLS__CLIENT__KEY (docs/cluster.md).",
            )
    try:
        with _quiet():
            return untyped_distributed.Client(
                address, timeout=CONNECT_S, security=security, set_as_default=False
            )
    except (OSError, RuntimeError, ValueError, TypeError, EOFError) as error:
        why = " ".join(str(error).split())[:160]
        raise LinkFaultError(
            f"--cluster {address} cannot be reached: {why}",
            remedy="Start it: dask scheduler --host 127.0.0.1.",
        ) from error


def _result(future: Any) -> Answer | Refusal | None:
    """Return the result of a task; None if there is none after a moment."""
    try:
        with _quiet():
            return future.result(timeout=_LOOK_S)  # type: ignore[no-any-return]
    except TimeoutError:
        return None


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the warnings of ``distributed`` from the terminal: everything important is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def on_cluster(address: str | None, tell: Callable[[str], None]) -> Iterator[None]:
    """Let a cluster answer all batches of the block; with ``address`` None this computer does.

    Parameters
    ----------
    tell
        Called with a description of the cluster.

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
