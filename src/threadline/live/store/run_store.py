"""Folders of runs: each keeps the proof, the inputs, the recording, the events and the verdict.

A run is written while it happens. Its folder and its row in the index exist before anything moves;
every block of the recording and every change of state is written at once, so that a run whose
program is killed keeps everything up to then.

The index only knows whether a run has passed. The folder of a run that has not passed tells whether
it is out of specification or not proven.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import IO, Any, Self

from threadline import __version__
from threadline.base.reading import naming, refuse_special
from threadline.base.wording import nearest
from threadline.commands.plan import Plan
from threadline.errors import InputError, StoreError, ThreadlineError
from threadline.files import Channel, Recording, RecordingBlock, Stream
from threadline.files.formats.recording_mcap import TraceWriter
from threadline.live.store.index import REFUSED, RunIndex, RunRecord
from threadline.proof.proof_file import ProofFile, copy_proof
from threadline.verdict.rendering import word_of_json

INDEX, PROOF, INPUTS, SENT, TRACE, EVENTS, VERDICT = (
    "index.sqlite", "proof.json", "inputs", "sent", "trace.mcap", "events.jsonl", "verdict.json",
)  # fmt: skip
SYNC_S = 0.5
"""Interval in s at which the trace is flushed to disk."""
INDEX_URL = "index.url"
"""File of a store whose index is a database elsewhere: its URL, in SQLAlchemy's form."""
_NAME = re.compile(r"[^A-Za-z0-9._-]+")


class RunStore:
    """A folder of runs.

    Parameters
    ----------
    folder
        Created if it does not exist.
    url
        Database URL of the index; None: the one in the folder's file ``index.url``, else the file
        ``index.sqlite`` in the folder.

    Raises
    ------
    StoreError
        If the folder cannot be made, or the index cannot be used.
    """

    def __init__(self, folder: Path, url: str | None = None) -> None:
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(
                f"cannot keep runs in {str(folder)!r}: {error.strerror or error}",
                remedy="Give another folder with --store.",
            ) from error
        self.index = RunIndex(url or _index_url(folder) or folder / INDEX)

    def begin(
        self,
        plan: Plan,
        proof: ProofFile,
        known: Mapping[str, str],
        speed: float,
        inputs: Iterable[Path] = (),
        sent: Mapping[str, bytes] | None = None,
    ) -> OpenRun:
        """Make the folder and the row of a run, before anything moves.

        Parameters
        ----------
        proof
            Proof of the plan; the file names in its copy still lead to the same files.
        known
            Entries of the recording's origin besides the options of the plan: ``link``, and
            ``override`` if the proof did not pass.
        speed
            Speed of the run as a multiple of real time.
        inputs
            Input files of the run, to be copied.
        sent
            Files by name that are sent to the machine besides the rows of the plan.
        """
        started_at = datetime.now().astimezone()
        stem = _NAME.sub("-", Path(plan.job.name).stem)[:40] or "run"
        path = self._made(f"{started_at:%Y%m%d-%H%M%S}-{stem}")
        try:
            return self._begun(path, plan, proof, known, speed, inputs, sent or {}, started_at)
        except BaseException:  # nothing has moved, and there is no row for it
            shutil.rmtree(path, ignore_errors=True)
            raise

    def _made(self, name: str) -> Path:
        """Return a new folder with that name, or with a number appended."""
        number = 1
        while True:
            path = self.folder / (name if number == 1 else f"{name}-{number}")
            with suppress(FileExistsError):
                path.mkdir()
                return path
            number += 1

    def _begun(
        self,
        path: Path,
        plan: Plan,
        proof: ProofFile,
        known: Mapping[str, str],
        speed: float,
        inputs: Iterable[Path],
        sent: Mapping[str, bytes],
        started_at: datetime,
    ) -> OpenRun:
        """Fill the folder of a run, and add its row; see ``begin``."""
        copied_proof = copy_proof(proof, path / PROOF)
        for file in inputs:
            _copy(file, _free(path / INPUTS, file.name))
        for file_name, content in sent.items():
            with naming(path, path):
                _free(path / SENT, file_name).write_bytes(content)
        name = path.name
        record = RunRecord(
            run=name,
            started=started_at.isoformat(timespec="microseconds"),
            job=plan.job.name,
            machine=plan.machine.name,
            link=known["link"],
            speed=speed,
            level=proof.level,
            proof_passed=proof.passed,
            override=known.get("override", ""),
            job_sha256=plan.job.sha256,
            machine_sha256=plan.machine.sha256,
            commands_sha256=proof.sha256("commands"),
            proof_sha256=str(copied_proof.content["sha256"]),
            threadline=__version__,
        )
        run = OpenRun(path, plan, {**known, "run": name}, self.index)
        try:
            self.index.add(record)
        except BaseException:
            run.close()
            raise
        return run

    def catch_up(self) -> None:
        """Enter the verdicts into the index that were missed while another program was writing.

        If the index is still locked, or a verdict cannot be read, nothing changes.
        """
        for record in self.index.runs():
            file = self.folder / record.run / VERDICT
            if record.passed is not None or not file.is_file():
                continue
            with suppress(StoreError, OSError, ValueError, KeyError, TypeError):
                content = json.loads(file.read_bytes())
                if "late_ticks" in content:  # the run was judged
                    _tell(self.index, record.run, {**content, "text": record.text})

    def find(self, run: str) -> Path:
        """Return the folder of a run by its name; ``last`` stands for the latest one.

        Raises
        ------
        StoreError
            If there is no run of that name.
        """
        names = [record.run for record in self.index.runs()]
        if run == "last" and names:
            return self.folder / names[0]
        if run not in names:
            raise StoreError(
                f"there is no run {run[:60]!r} in {str(self.folder)!r}",
                remedy=nearest(run, names) if names else "threadline run makes one.",
            )
        return self.folder / run


def _tell(index: RunIndex, run: str, content: Mapping[str, Any]) -> None:
    """Write verdict and end of a run into its row of the index."""
    index.end(
        run,
        ended=str(content["ended"]),
        text=str(content["text"]),
        late_ticks=int(content["late_ticks"]),
        passed=bool(content["passed"]),
    )


def _index_url(folder: Path) -> str | None:
    """Return the URL of the index that the folder names; None if it names none.

    Raises
    ------
    StoreError
        If the file cannot be read, or holds no URL.
    """
    file = folder / INDEX_URL
    if not os.path.lexists(file):  # a dangling link must not create a new store
        return None
    try:
        refuse_special(file)
        url = file.read_text("utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise StoreError(
            f"{str(file)!r} cannot be read",
            remedy="It must hold the URL of the index, or not exist.",
        ) from error
    if "://" not in url or len(url.split()) != 1:
        raise StoreError(
            f"{str(file)!r} holds no URL of a database",
            remedy='Write one line, like "postgresql+psycopg://user@host/runs".',
        )
    return url


def _free(folder: Path, name: str) -> Path:
    """Return an unused path in ``folder``: ``name``, or with a number before it."""
    folder.mkdir(exist_ok=True)
    number = 1
    while (path := folder / (name if number == 1 else f"{number}-{name}")).exists():
        number += 1
    return path


def _copy(file: Path, copy_path: Path) -> None:
    """Copy an input; if the copy cannot be written, the error names the copy."""
    with file.open("rb") as source, naming(copy_path, copy_path), copy_path.open("wb") as target:
        shutil.copyfileobj(source, target)


def check_folder(folder: Path) -> None:
    """Refuse a path that is not a folder, and could not become one; nothing is made.

    Raises
    ------
    StoreError
        If a file stands there, or where a folder above it would be.
    """
    existing = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    if existing.exists() and not existing.is_dir():
        obstacle = "" if existing == folder else f": {str(existing)!r} is a file"
        raise StoreError(
            f"{str(folder)!r} is no folder of runs{obstacle}",
            remedy="Give the folder with --store.",
        )


def opened(folder: Path) -> RunStore | None:
    """Return the store in ``folder``, or None if there are no runs; nothing is made.

    Raises
    ------
    StoreError
        If it is no folder, or the index cannot be used.
    """
    check_folder(folder)
    has_index = any(os.path.lexists(folder / name) for name in (INDEX, INDEX_URL))
    if not has_index:
        return None
    store = RunStore(folder)
    store.catch_up()
    return store


class OpenRun:
    """A run that is being written; an executor uses it as its sink.

    Attributes
    ----------
    path
        Folder of the run.
    """

    def __init__(self, path: Path, plan: Plan, known: Mapping[str, str], index: RunIndex) -> None:
        self.path, self._plan, self._known, self._index = path, plan, known, index
        self._events: IO[str] = (path / EVENTS).open("w", encoding="utf-8")
        self._trace: IO[bytes] = (path / TRACE).open("wb")
        self._writer: TraceWriter | None = None
        self._disk, self._synced_s = ThreadPoolExecutor(1), 0.0
        self._syncing: Future[None] | None = None

    @property
    def trace(self) -> Path:
        """Path of the recording's file."""
        return self.path / TRACE

    def close(self) -> None:
        """Close the files of a run that does not begin."""
        self._disk.shutdown()
        self._trace.close()
        self._events.close()

    def begin(self, channels: tuple[Channel, ...], simulated: bool) -> None:
        """Write the head of the recording: its channels and its origin."""
        plan = self._plan
        recording_head = Recording(
            channels=channels,
            blocks=Stream.of(()),
            job_sha256=plan.job.sha256,
            machine_sha256=plan.machine.sha256,
            simulated=simulated,
            origin={**plan.options, **self._known},
        )
        with naming(self.path, self.path):
            self._writer = TraceWriter(self._trace, recording_head)

    def block(self, block: RecordingBlock) -> None:
        """Write a block of samples and its events."""
        assert self._writer is not None
        with naming(self.path, self.path):
            self._writer.write(block)
        self._order_to_disk()

    def _order_to_disk(self) -> None:
        """Flush the trace to disk in the background, so that it survives a loss of power."""
        now_s = time.monotonic()
        is_syncing = self._syncing is not None and not self._syncing.done()
        if not is_syncing and now_s >= self._synced_s + SYNC_S:
            self._synced_s = now_s
            self._syncing = self._disk.submit(os.fsync, self._trace.fileno())

    def state(self, tick: int, state: str, cause: str, text: str) -> None:
        """Write that the executor changed its state at a tick, with cause and text."""
        line = {"tick": tick, "state": str(state), "cause": str(cause), "text": text}
        with naming(self.path, self.path):
            self._events.write(json.dumps(line, ensure_ascii=False) + "\n")
            self._events.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, error: BaseException | None, _trace: object
    ) -> None:
        """Close the files; if an error ended the run, write that into the index."""
        self._disk.shutdown(wait=True)
        with naming(self.path, self.path):
            if error is None and self._writer is not None:
                self._writer.finish()
            for file in (self._trace, self._events):
                try:
                    file.close()
                except OSError:
                    if error is None:  # else that error has priority
                        raise
        if error is not None:
            self._broken_off(error)

    def _broken_off(self, error: BaseException) -> None:
        """Write into the index which error ended the run; a refused run gets a verdict."""
        text, ended = "the program was ended", "fault"
        if isinstance(error, ThreadlineError):
            text = error.message
        elif isinstance(error, OSError):
            text = f"the trace could not be written: {error.strerror or error}"
        if isinstance(error, InputError):  # by the executor, at the start: nothing has moved
            self.unjudged(REFUSED, text)
        else:
            with suppress(StoreError):  # the error that ended the run has priority
                self.over(ended, text)

    def over(self, ended: str, text: str) -> None:
        """Write into the index how a run ended, before judging, which may be interrupted."""
        self._index.end(self.path.name, ended=ended, text=text, late_ticks=0, passed=None)

    def unjudged(self, ended: str, text: str) -> None:
        """Write that a run ended before there was anything to judge."""
        plan = self._plan
        content = {"job": plan.job.name, "machine": plan.machine.name, **self._known}
        self._write({**content, "passed": False, "criteria": [], "ended": ended, "text": text})
        self.over(ended, text)

    def _write(self, content: Mapping[str, Any]) -> None:
        """Write the verdict to a temporary file, and move it into place: all or nothing."""
        text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        path, temporary_path = self.path / VERDICT, self.path / f".{VERDICT}"
        try:
            with naming(path, temporary_path), temporary_path.open("w", encoding="utf-8") as file:
                file.write(f"{text}\n")
                file.flush()
                os.fsync(file.fileno())
            temporary_path.replace(path)
        finally:
            temporary_path.unlink(missing_ok=True)

    def judged(self, content: Mapping[str, Any], ended: str, text: str) -> str:
        """Write the verdict into the folder, and verdict and end of the run into the index.

        Returns
        -------
        str
            Why the index could not be updated, and what will update it; empty if it was. The run is
            kept in any case.
        """
        self._write(content)
        try:
            _tell(self._index, self.path.name, {**content, "ended": ended, "text": text})
        except StoreError as error:
            return (
                f"the run and its verdict are kept in {self.path}, but {error.message}; "
                f"threadline runs --store {self.path.parent} enters it into the index later"
            )
        return ""


NOT_JUDGED = "not judged"


def verdict_of_run(record: RunRecord, folder: Path) -> str:
    """Return the verdict of a run in a word or two; ``folder`` is the folder of the run."""
    if record.ended == REFUSED:
        return REFUSED
    if record.passed is None:
        return NOT_JUDGED
    return _word(folder / VERDICT, record.passed)


def verdict_of_proof(record: RunRecord, folder: Path) -> str:
    """Return the verdict of the proof with which a run began, without its level."""
    return _word(folder / PROOF, record.proof_passed)


def _word(file: Path, passed: bool) -> str:
    """Return the verdict of a file in a word; from the index if the file cannot be read."""
    try:
        content: Mapping[str, Any] = json.loads(file.read_bytes())
        verdict = content.get("verdict", content)  # a proof has a verdict, and its level beside it
        return word_of_json({**verdict, "level": content.get("level")})
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return "in spec" if passed else "not passed"
