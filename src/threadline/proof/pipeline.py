"""Runs all stages in order, by the table of kinds: plan, simulate, judge, write."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from threadline.base.option_defaults import MOST_RUNS
from threadline.base.progress import PLANNING, Progress, part_of
from threadline.base.wording import nearest
from threadline.base.writing import together
from threadline.commands.plan import Plan
from threadline.commands.write import Target
from threadline.errors import OptionError
from threadline.files import Commands, Recording
from threadline.files.formats.common import Written
from threadline.jobs import read_job
from threadline.jobs.gcode.feeds import parse_feed_mode
from threadline.jobs.operations import Job
from threadline.jobs.shifted import shifted
from threadline.machine import Machine
from threadline.machine.model import check_dynamics
from threadline.machine.radii import with_radii
from threadline.machine.variants import check_uncertain, drawn
from threadline.machine.vary import REPEAT_SEED, Others, band_of, ends_of
from threadline.proof.kinds import KINDS, kind_of, kind_of_commands
from threadline.proof.kinds.kind import Share, check_loops
from threadline.proof.kinds.variants import played_by, rejects
from threadline.proof.options import Options
from threadline.proof.over_tolerances import VARIANT_SEED, Judged, Suspects, over_tolerances
from threadline.proof.worst_machine import Worst
from threadline.verdict import Judge, Spec, Status, Verdict
from threadline.verdict.deviation import measure_motion_deviation
from threadline.verdict.each_run import worst_of
from threadline.verdict.rendering import shown
from threadline.verdict.replayed import of_product, with_beginning
from threadline.verdict.types import REPEATED_RUNS, Level, level_of

__all__ = [
    "NOMINAL", "REPEATED", "TOLERANCES", "Proof", "Trials", "check_loops", "check_machine",
    "open_job", "plan_job", "prove", "prove_plan", "run_by", "simulate", "target_names",
    "target_of", "try_plan", "with_product", "with_shaping", "write", "yielding",
]  # fmt: skip

_MOST_SAMPLES = 5e7  # ticks times runs: half a minute
_MOST_HELD = 1e6  # samples of the lag times runs, in memory


@dataclass(frozen=True, slots=True, kw_only=True)
class Trials:
    """The runs that make up a verdict: its level.

    Parameters
    ----------
    repeats
        Number of runs of the machine. The first run has the numbers of the machine file. For the
        other runs friction is drawn within +-30 %, supply within +-5 %, and encoder phases and the
        jitter of PLC scans at random, from a fixed seed; for step tables only damping is drawn,
        within +-30 %. The spread of these runs is the repeatability. If twenty runs come near a
        limit, and machines are simulated in batches, ``MOST_RUNS`` are simulated, or fewer for a
        long job.
    machines
        Number of machines that are drawn within the tolerances of the file from a fixed seed.
        Without ``wanted_yield`` the worst machine within the tolerances is searched as well.
    wanted_yield
        Smallest share of the drawn machines that must be in spec. With None every machine that is
        drawn or searched must be in spec.
    ends
        Machines whose loads and springs are at the ends of this share of their tolerances are
        judged as well, in one run each.
    band
        Half width of a band, as a share of the frequency of every mode. Machines with modes all
        over this band are judged as well, in one run each.
    product
        Places of the numbers of the product within their tolerances, for every run; empty for the
        nominal product.
    """

    repeats: int = 1
    machines: int = 0
    wanted_yield: float | None = None
    ends: float | None = None
    band: float | None = None
    product: tuple[float, ...] = ()

    def others(self, machine: Machine) -> dict[Literal["ends", "band"], Others]:
        """Return the further machines that must pass, by the option that asks for them.

        Raises
        ------
        OptionError
            If ``ends`` is given and no load or spring of ``machine`` has a tolerance, or if
            ``band`` is given and the machine has no spring.
        """
        by_option: dict[Literal["ends", "band"], Others] = {}
        if self.ends is not None:
            by_option["ends"] = ends_of(machine, self.ends)
        if self.band is not None:
            by_option["band"] = band_of(machine, self.band)
        return by_option

    @property
    def without_others(self) -> Trials:
        """The same trials without the machines of ``others``."""
        return replace(self, ends=None, band=None)

    @property
    def level(self) -> Level:
        """Level of a verdict over these runs."""
        return level_of(self.repeats, self.machines, self.wanted_yield)


NOMINAL: Trials = Trials()
REPEATED: Trials = Trials(repeats=REPEATED_RUNS)
TOLERANCES: Trials = Trials(repeats=REPEATED_RUNS, machines=200)


def yielding(share: float) -> Trials:
    """Return the trials that check whether ``share`` of the machines are in specification."""
    return Trials(repeats=REPEATED_RUNS, machines=1000, wanted_yield=share)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proof:
    """A plan, its simulated runs, the specification, and the verdict.

    Parameters
    ----------
    recording
        The first run: the nominal machine, with every channel.
    judged
        The judged recordings that are kept; a recording may hold several runs. The recordings of
        the worst machine within the tolerances come last.
    runs
        Number of judged runs.
    actual
        The machine that ran, if it is not the planned one.
    worst
        The worst machine within the tolerances that was found; None if it was not searched.
    """

    plan: Plan
    recording: Recording
    verdict: Verdict
    spec: Spec
    judged: tuple[Recording, ...]
    runs: int = 1
    actual: Machine | None = None
    worst: Worst | None = None

    def run(self, number: int) -> Recording:
        """Return a judged run by its number, as in ``Result.run``.

        Raises
        ------
        IndexError
            If there is no such run.
        """
        for recording in self.judged:
            if number <= recording.runs:
                return recording.run(number)
            number -= recording.runs
        raise IndexError(number)


def check_machine(machine: Machine) -> None:
    """Refuse an unusable machine before any motion is planned.

    Raises
    ------
    PlanError
        If one of its loops is unstable.
    """
    kind_of(machine).check(machine)


def open_job(job_file: Path, machine: Machine, options: Options) -> Job:
    """Return the job in a file, read with the options.

    Raises
    ------
    JobError
        If it cannot be read.
    OptionError
        If an option does not apply to this kind of machine, or if the format of the job or the
        machine does not have the given rule for F.
    """
    kind_of(machine).check_options(machine, options)
    reading = {} if options.dialect is None else {"dialect": options.dialect}
    if options.feed_mode is not None:
        reading |= parse_feed_mode(options.feed_mode)
    if options.axes is not None:
        reading["axes"] = options.axes
    if options.needle is not None:
        reading["needle_speed"] = options.needle
    if options.long_stitches is not None:
        reading["long_stitches"] = options.long_stitches
    fitted = with_radii(machine, options.radius)
    return shifted(read_job(job_file, fitted, **reading), fitted, options.offset)


def plan_job(job: Job, machine: Machine, options: Options) -> Plan:
    """Plan ``job`` on ``machine``: the intended motion, and the commands for it.

    Raises
    ------
    PlanError
        If the machine cannot do the job.
    OptionError
        If an option does not apply to this kind of machine.
    """
    kind, options = kind_of(machine), options.on(machine)
    kind.check_options(machine, options)
    fitted = with_radii(machine, options.radius)
    if options.product is not None:
        from threadline.winding.product import with_mandrel  # only windings need it

        fitted = with_mandrel(fitted, options.product)
    plan = kind.plan(job, fitted, options)
    return plan if fitted.mounted is None else with_beginning(plan)


def simulate(commands: Commands, machine: Machine) -> Recording:
    """Return the recording of ``machine`` playing ``commands``, of any kind, once.

    Raises
    ------
    MachineError
        If the machine's parts cannot be simulated.
    OptionError, RecordingError
        If the commands are not for this machine, or an input that they wait for never comes.
    """
    return kind_of_commands(commands).simulate(commands, machine)


def with_shaping(spec: Spec, machine: Machine, options: Options) -> Spec:
    """Return the specification with the criteria that the options add.

    The path deviation due to shaping and smoothing is always listed, with or without a limit.
    """
    return kind_of(machine).with_criteria(spec, machine, options)


def with_product(spec: Spec, machine: Machine, options: Options) -> Spec:
    """Return the specification with the criteria of a winder's product, if there is one."""
    return spec if options.product is None else with_shaping(spec, machine, options)


def target_names() -> tuple[str, ...]:
    """Return the names of all targets."""
    return tuple(sorted(name for kind in KINDS.values() for name in kind.targets))


def target_of(name: str, machine: Machine) -> Target:
    """Return a target of a machine; refuse other targets before anything is planned.

    Raises
    ------
    OptionError
        If it is unknown or belongs to another kind of machine.
    """
    targets = kind_of(machine).targets
    if name in targets:
        return targets[name]
    if name not in target_names():
        raise OptionError(f"unknown target {name[:40]!r}", remedy=nearest(name, sorted(targets)))
    raise OptionError(
        f"target {name!r} is for another kind of machine than {machine.name}, which is "
        f"commanded by {machine.commanded_by}",
        remedy=f"Use {' or '.join(targets)}.",
    )


def write(plan: Plan, target: str, out: str | Path, *, slower: bool = True) -> list[Written]:
    """Write ``plan`` for a controller: all files or none.

    Parameters
    ----------
    target
        ``csv``: a line for every tick. ``npz``: the same as arrays. ``ticks``: the trajectory
        array of the 1994 controller. ``nc``: the planned motion as a part program for LinuxCNC,
        a block for each interval of time. ``grbl``, ``fluidnc``, ``marlin``, ``klipper``,
        ``reprapfirmware``, ``linuxcnc``, ``fanuc``: chords for a controller that plans its own
        ramps. ``st``: structured text for a PLC, with the configuration in a second file.
        ``openplc``: structured text and configuration in one file, for OpenPLC. ``plcopen``: both
        as PLCopen XML. ``scl``: the program for a Siemens S7. ``steps``: step tables and stitches,
        binary and CSV, with a manifest. ``t15``: a Saurer T15 card. ``dst``, ``u01``: the design
        for machines of Tajima and of Barudan.
    slower
        Whether a program may take longer on its firmware than the original job.

    Returns
    -------
    list of Written
        The files with their hashes.

    Raises
    ------
    OptionError
        If there is no such target, or it belongs to another kind of machine.
    PlanError
        If the commands exceed a limit, or the program is slower than permitted; then nothing is
        written.
    """
    entry = target_of(target, plan.machine)
    kind_of(plan.machine).release(plan)
    with together():
        writer = entry.write if slower else entry.write_no_slower or entry.write
        files = writer(plan, Path(out))
    if entry.takes_shaped or not files:
        return files
    # The written file was compared with the plan; the plan itself deviates from the program.
    return [replace(files[0], facts=(*files[0].facts, _off_program(plan))), *files[1:]]


def _off_program(plan: Plan) -> str:
    (deviation,) = measure_motion_deviation(plan)
    line_text = "" if deviation.job_line is None else f" (job line {deviation.job_line})"
    deviation_mm = 1e3 * (deviation.value or 0.0)
    return f"corners are cut by up to {deviation_mm:.2g} mm, at the tool{line_text}"


def prove(
    job_file: Path,
    machine: Machine,
    spec: Spec,
    options: Options,
    progress: Progress | None = None,
    trials: Trials = NOMINAL,
    actual: Machine | None = None,
) -> Proof:
    """Plan, simulate and judge a job.

    ``progress``, ``trials`` and ``actual`` as for ``prove_plan``.

    Raises
    ------
    InputError
        If the job cannot be read, planned or judged on this machine.
    """
    check_machine(machine)
    if progress is not None:
        PLANNING.reach(0.0)
        progress("planning", 0.0)
    plan = plan_job(open_job(job_file, machine, options), machine, options)
    return prove_plan(plan, spec, progress, trials, actual)


def prove_plan(
    plan: Plan,
    spec: Spec,
    progress: Progress | None = None,
    trials: Trials = NOMINAL,
    actual: Machine | None = None,
    judge: Judge | None = None,
    suspects: Suspects | None = None,
) -> Proof:
    """Simulate and judge a plan.

    Parameters
    ----------
    trials
        The runs that make up the verdict.
    actual
        The machine that runs the plan, if it is not the planned one: for example with other masses
        or stiffnesses than feed-forward assumes.
    judge
        A judge that has judged this plan by this spec before, to reuse its measures of the plan.
    suspects
        For a search: the worst machines of earlier plans, as ``over_tolerances`` takes them; the
        proof ends at the first machine that is out of specification.

    Raises
    ------
    OptionError
        If ``trials`` asks for other machines, but no number has a tolerance or the machine file has
        no dynamics.
    """
    judge = Judge(plan, spec) if judge is None else judge
    if trials != trials.without_others:
        return _with_others(plan, spec, progress, trials, actual, judge, suspects)
    if trials.machines:
        check_dynamics("the motion of another machine", plan.machine)
    own_plan = plan if actual is None else run_by(plan, actual)
    kind = kind_of_commands(plan.commands)
    random = np.random.default_rng(REPEAT_SEED)
    machine, commands = own_plan.machine, own_plan.commands
    origin = dict(plan.options) | ({} if actual is None else {"actual": actual.reference})
    recordings = of_product(kind.days(commands, machine, trials.repeats, random), trials.product)
    if trials.machines:
        check_uncertain(machine)
    share = Share(plan, progress, len(recordings))
    verdict, worst = judge.verdict(share.of(recordings)), None
    if trials.repeats == REPEATED_RUNS and verdict.near and kind.together(machine):
        run_count = _runs_within_reach(plan, spec)
        if run_count > trials.repeats:  # the first ``trials.repeats`` runs are the same again
            more = kind.days(commands, machine, run_count, np.random.default_rng(REPEAT_SEED))
            recordings = of_product(more, trials.product)
            further_verdict = judge.verdict(Share(plan, progress, len(recordings)).of(recordings))
            verdict = _beside_first(further_verdict, verdict)
    others: tuple[Recording, ...] = ()
    if trials.machines and trials.wanted_yield is None:

        def runs_of(other_machine: Machine, product: tuple[float, ...]) -> Judged:
            one_machine_trials = replace(trials, machines=0, product=product)
            proof = prove_plan(plan, spec, None, one_machine_trials, other_machine, judge)
            return proof.verdict, proof.judged

        worst_case = over_tolerances(
            own_plan, spec, verdict, trials.machines, runs_of, progress, suspects
        )
        verdict, worst, others = worst_case.verdict, worst_case.worst, worst_case.judged
    if trials.wanted_yield is not None:
        parts = drawn(machine, VARIANT_SEED, np.arange(trials.machines))
        plan_drawn = plan if actual is None else replace(plan, machine=machine)
        rejects_result, tried = rejects(kind, plan_drawn, judge, parts, trials.wanted_yield, random)
        results = (*verdict.results, rejects_result)
        verdict = replace(
            verdict, results=results, machines=tried, wanted_yield=trials.wanted_yield
        )
    return Proof(
        plan=plan,
        recording=replace(kind.simulate(commands, machine), origin=origin),
        verdict=verdict,
        spec=spec,
        judged=(*recordings, *others),
        runs=verdict.runs,
        actual=None if actual is None else machine,
        worst=worst,
    )


def run_by(plan: Plan, actual: Machine) -> Plan:
    """Return a plan with its commands, and with the machine that runs them in its machine's place.

    A mandrel is mounted on that machine as well.

    Raises
    ------
    OptionError
        If the machine cannot play the commands, or one of the machines has no dynamics.
    """
    if actual.spool is not None:
        actual = replace(actual, mounted=plan.machine.mounted)
    check_dynamics("the motion of another machine", plan.machine, actual)
    return replace(plan, machine=actual, commands=played_by(plan.commands, plan.machine, actual))


def _runs_within_reach(plan: Plan, spec: Spec) -> int:
    """Return how many runs of a plan are simulated if twenty runs come near a limit."""
    tick_s = float(plan.machine.tick_clock.period_s)
    runs = min(_MOST_SAMPLES / (plan.commands.tick_count() or 1), _MOST_HELD * tick_s / spec.lag_s)
    return min(MOST_RUNS, int(runs))


def _beside_first(verdict: Verdict, first: Verdict) -> Verdict:
    """Return the verdict of many runs, with notes on the results of the first runs."""
    results = []
    for result, early in zip(verdict.results, first.results, strict=True):
        note = result.note
        if result.limit and result.typical is not None and result.measured != early.measured:
            came = "-" if early.measured is None else shown(early.measured, early.unit)
            note = "; ".join(filter(None, (note, f"{came} in the first {first.runs} runs")))
        results.append(replace(result, note=note))
    return replace(verdict, results=tuple(results))


def _with_others(
    plan: Plan, spec: Spec, progress: Progress | None, trials: Trials, actual: Machine | None,
    judge: Judge, suspects: Suspects | None,
) -> Proof:  # fmt: skip
    """Prove a plan, and judge it on the machines of ``trials.others``."""
    proof = prove_plan(plan, spec, progress, trials.without_others, actual, judge, suspects)
    verdict = proof.verdict
    for name, others in trials.others(plan.machine if actual is None else actual).items():
        verdicts = []
        for label, other in others.machines:
            # Amplitudes computed from place and speed depend on the mode of the machine that ran.
            judging = Judge(replace(plan, machine=other), spec) if name == "band" else judge
            verdicts.append((label, prove_plan(plan, spec, None, NOMINAL, other, judging).verdict))
        verdict = worst_of(verdict, verdicts, name)
    return replace(proof, verdict=verdict)


def try_plan(
    plan: Plan,
    spec: Spec,
    trials: Trials = NOMINAL,
    actual: Machine | None = None,
    suspects: Suspects | None = None,
    *,
    progress: Progress | None = None,
) -> Proof:
    """Prove a plan for a search; end early if the plan is out of spec.

    The machine of the file is judged in one run, then in all runs. Then ``suspects`` are judged,
    and the worst machine is added. ``progress`` gets the done share of the file machine's runs.
    """
    judge = Judge(plan, spec)
    stages = dict.fromkeys((NOMINAL, Trials(repeats=trials.repeats)))
    runs, runs_before = sum(stage.repeats for stage in stages), 0
    for stage in stages:
        stage_progress = part_of(progress, runs_before / runs, stage.repeats / runs)
        runs_before += stage.repeats
        proof = prove_plan(plan, spec, stage_progress, stage, actual, judge)
        failed = any(result.status is Status.FAILED for result in proof.verdict.results)
        if stage == trials or failed:
            return proof
    known_suspects = [] if suspects is None else suspects
    return prove_plan(plan, spec, None, trials, actual, judge, known_suspects)
