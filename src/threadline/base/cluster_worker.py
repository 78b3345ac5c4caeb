"""The code that a worker of a cluster runs: it answers the items of a task with a prepared work.

Every task names its work by a digest. A worker plans and compiles once for each digest. It returns
the bits of its result for a known item, and refuses to work if its versions differ from the
versions of the command.
"""

from __future__ import annotations

import hashlib
import pickle
import platform
import threading
import time
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from threadline import __version__
from threadline.base.workers import Work

MOST_WORKS = 8
"""Number of works that a worker keeps ready."""
_ENGINES = ("numpy", "scipy", "numba", "llvmlite")


def versions() -> dict[str, str]:
    """Return everything that may change the bits of an answer: versions and a digest of sources.

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
    """Return a digest of the files of this package."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        digest.update(file.relative_to(root).as_posix().encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """The reason why a worker gives no answer."""

    worker: str
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """Answers, the worker that gave them, its time per item, and its bits for a known machine."""

    worker: str
    known: bytes
    answers: list[Any]
    item_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ready:
    """A prepared work, and the bits of its known answer on this worker."""

    work: Work[Any, Any]
    known: bytes


_ready: OrderedDict[str, _Ready] = OrderedDict()
_preparing = threading.Lock()


def same(content: bytes) -> bytes:
    """Return the content; this is the task on which all tasks of a work depend."""
    return content


def answer_on_worker(
    content: bytes, digest: str, expected_versions: Mapping[str, str], items: Sequence[Any]
) -> Answer | Refusal:
    """Return the answers to the items of a task; this runs on a worker.

    Parameters
    ----------
    content
        The pickled work.
    digest
        Digest of the pickled work.
    expected_versions
        Versions that the worker must have.
    """
    from distributed import get_worker

    worker = str(get_worker().address)
    if difference := other_versions(versions(), expected_versions):
        return Refusal(worker=worker, why=difference)
    try:
        ready = _prepared(content, digest)
        begun_s = time.monotonic()
        answers = [ready.work.answer(item) for item in items]
        item_s = (time.monotonic() - begun_s) / len(items)
        return Answer(worker=worker, known=ready.known, answers=answers, item_s=item_s)
    except OSError as error:
        problem = f"{error.strerror or error}: {error.filename}" if error.filename else str(error)
        return Refusal(worker=worker, why=f"cannot read a file of the job: {problem}")


def _prepared(content: bytes, digest: str) -> _Ready:
    """Return a prepared work; the threads of one worker prepare it only once."""
    with _preparing:
        if digest not in _ready:
            work = pickle.loads(content)  # noqa: S301 - the scheduler runs whatever it is sent
            _ready[digest] = _Ready(work=work, known=work.known())
            while len(_ready) > MOST_WORKS:
                _ready.popitem(last=False)
        _ready.move_to_end(digest)
        return _ready[digest]


def other_versions(here: Mapping[str, str], expected_versions: Mapping[str, str]) -> str:
    """Return in words which versions differ; empty if all agree."""
    differences = [
        f"{name} {here.get(name, 'none')} instead of {expected_version}"
        for name, expected_version in expected_versions.items()
        if here.get(name) != expected_version
    ]
    return f"has {', '.join(differences)}" if differences else ""
