"""Run a job over a link to a machine, from Python."""

from __future__ import annotations

import tempfile
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from threadline.base.arguments import checked
from threadline.errors import RecordingError
from threadline.face.answers import Answer, PathLike
from threadline.machine import Machine
from threadline.proof.option_form import Door, Word
from threadline.proof.python_arguments import with_options
from threadline.proof.request import Words

if TYPE_CHECKING:
    from threadline.files import Recording
    from threadline.proof.recorded import Judged

__all__ = ["Ran", "run"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Ran(Answer):
    """A run that was judged.

    Parameters
    ----------
    of
        Recording, plan, specification and verdict.
    folder
        Folder of the run in the store.
    ended
        ``"completed"`` or ``"stopped"``; a fault raises an error instead.
    notes
        Notes about the link, holds and the store, as the command line prints them.
    """

    of: Judged
    folder: Path
    ended: str
    notes: tuple[str, ...] = ()

    @property
    def recording(self) -> Recording:
        """The recording of the machine during the run."""
        return self.of.recordings[0]


@with_options
@checked
def run(
    job: PathLike,
    machine: PathLike | Machine,
    *,
    link: str = "sim",
    speed: float = 1.0,
    store: PathLike = "runs",
    proof: PathLike | None = None,
    key: PathLike | None = None,
    override: str | None = None,
    approach: bool = False,
    pass_stops: bool = False,
    **words: Word,
) -> Ran:
    """Run a job on the machine: prove it, execute it, record it, and judge the recording.

    The first Ctrl-C brakes along the path to a standstill, the second raises ``KeyboardInterrupt``
    and leaves the machine to its own braking. Neither is an emergency stop, which must be a circuit
    of the machine. A hold by the machine or its controller stops the run if it lasts longer than
    10 s.

    Parameters
    ----------
    job, machine
        As ``prove`` takes them.
    link
        ``"sim"`` and ``"sim:slower"`` are simulated machines in a process of their own,
        ``"grbl:HOST:PORT"`` and ``"grbl:/dev/ttyUSB0"`` controllers with grbl, ``"hal:loopback"``
        and ``"hal:plant"`` LinuxCNC's HAL without a machine.
    speed
        Simulated seconds per second of real time, for ``"sim"``; 0 is as fast as possible.
    store
        Folder of runs; the first run makes it.
    proof, key
        Proof file to run by, which must match job, machine, specification and options; and the file
        of the key that signed it. Without a proof file the job is proved first.
    override
        Reason for running a job that is out of specification; it is stored with the run.
    approach
        Whether to move the axes to the start of the program first, one after the other; for grbl.
    pass_stops
        Whether to pass program stops (M0): this function cannot ask an operator to resume.
    **words
        The planning and judging options of ``threadline run``.

    Raises
    ------
    InputError
        As on the command line; the machine has not moved then.
    LinkFaultError
        If the machine or the link failed; the folder of the run holds the recording up to then.
    """
    from threadline.base.reading import inputs_read
    from threadline.files import RunEnd
    from threadline.live.job_run import (
        Manner,
        checked_speed,
        execute,
        fault_of,
        judge_run,
        unattended,
    )
    from threadline.live.links import link_of
    from threadline.live.store.run_store import RunStore, check_folder
    from threadline.live.supervised import (
        check_halts,
        check_override,
        check_runnable,
        interventions,
    )
    from threadline.proof import pipeline
    from threadline.proof.proof_file import read_proof, write_proof
    from threadline.proof.proof_hash import read_key
    from threadline.proof.recorded import Judged

    check_override(override)
    given = Words.of("run", Door.PYTHON, words)
    trials, chosen = given.trials(), given.machine(machine)
    secret = None if key is None else read_key(key)
    actual = given.actual()
    over = link_of(link, chosen, checked_speed(speed), None, approach=approach, actual=actual)
    check_folder(Path(store))
    options = given.options(job)
    spec = pipeline.with_shaping(given.spec(chosen), chosen, options)
    pipeline.check_machine(chosen)
    if proof is not None:
        read_proof(Path(proof), secret)  # fail on an unreadable proof before planning
    with tempfile.TemporaryDirectory() as folder, closing(over):
        plan = pipeline.plan_job(pipeline.open_job(Path(job), chosen, options), chosen, options)
        check_halts(plan, answered=pass_stops)
        file = Path(folder) / "proof.json" if proof is None else Path(proof)
        if proof is None:
            write_proof(pipeline.prove_plan(plan, spec, None, trials), file)
        known = check_runnable(file, plan, spec, override, secret)
        notes = list(over.prepare(plan))
        recorded = {
            "link": link,
            **({} if actual is None else {"simulated": given.text("actual") or actual.name}),
            **({"label": over.label} if over.label else {}),
            **({"override": override} if override else {}),
        }
        may = interventions(plan, spec)
        may = may.at_once() if over.holds_at_once else may
        notes += may.notes
        manner = Manner(may=may, recorded=recorded, pass_stops=pass_stops)
        inputs = [one for one in inputs_read() if not one.samefile(file)]
        open_run = RunStore(Path(store)).begin(plan, known, recorded, speed, inputs, over.sent)
        done = execute(over, plan, open_run, manner, unattended)
    judged = judge_run(done, plan, spec, manner)
    if done.ended is RunEnd.FAULT:
        raise fault_of(done, over)
    if judged.verdict is None:
        raise RecordingError(
            f"{judged.text}: nothing was recorded to be judged",
            remedy=f"The folder of the run is {open_run.path}.",
        )
    of = Judged(recordings=(judged.recording,), plan=plan, spec=spec, verdict=judged.verdict)
    notes += [judged.warned] if judged.warned else []
    return Ran(of, open_run.path, done.ended.value, tuple(notes))
