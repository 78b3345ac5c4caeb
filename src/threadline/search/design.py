"""Search for the smallest change that meets a specification: tried machines and a proved one.

A design is written as a machine file based on the redesigned machine, and its specification.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.progress import Progress
from threadline.base.summary import Summarised, Summary
from threadline.base.wording import ascii_only, toml_string
from threadline.base.writing import together
from threadline.files.formats.common import atomic_file
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.load import split_reference
from threadline.machine.model import check_dynamics
from threadline.machine.numbers import number_at, number_tables
from threadline.machine.quantity import Quantity
from threadline.proof.kinds import kind_of
from threadline.proof.options import Options
from threadline.proof.pipeline import REPEATED, Trials
from threadline.search.design_evaluate import AHEAD, FEW, THOROUGH, Effort, Evaluator, Tried
from threadline.search.design_front import CandidateYield, marked
from threadline.search.design_judge import OtherRuns
from threadline.search.design_proof import (
    Candidate,
    ProvedDesign,
    candidate_at,
    cheapest_first,
    proved,
)
from threadline.search.design_search import Region, known_points, pareto, region_of, with_settings
from threadline.search.design_searches import (
    Search,
    Searching,
    most_ratio,
    pooled,
    within_progress,
)
from threadline.search.design_single_proofs import JobReader
from threadline.search.design_space import Space, design_space
from threadline.verdict import Spec
from threadline.verdict.registry import MEASURES
from threadline.verdict.rendering import percent_used
from threadline.verdict.types import Level

_SPEC_SUFFIX = ".spec.toml"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class DesignResult(Summarised):
    """Result of a search for the smallest change; prints itself as a table.

    Parameters
    ----------
    machine, job
        The original machine, and the job read for it.
    found
        The proved design; None where no change within the bounds meets the specification.
    pareto
        Candidates by cost against margin, the cheapest first.
    known
        The best settings of each known answer, by its title.
    as_built
        The original machine with the best settings.
    region
        Candidates in spec around the design, over two parameters; None with fewer than two.
    nearest
        The candidate that came nearest to the specification.
    simulated
        Number of machines simulated in the search.
    level
        Wanted level of the design.
    screened
        The runs that ``Candidate.ratio`` covers, in words.
    refused
        Why the proof refused candidates that the search accepted.
    front
        Yields of candidates by their cost, the cheapest first; empty if they were not asked for.
    """

    machine: Machine
    job: Job
    space: Space
    found: ProvedDesign | None
    pareto: tuple[Candidate, ...]
    known: Mapping[str, Candidate]
    as_built: Candidate
    region: Region | None
    nearest: Candidate
    simulated: int
    level: Level
    screened: str
    refused: tuple[str, ...]
    front: tuple[CandidateYield, ...] = ()

    def sentence(self) -> str:
        """Return one sentence: the design that was found, or the criterion that prevents one."""
        if self.found is not None:
            candidate = self.found.candidate
            changed = [f"{n} x {f:.3g}" for n, f in candidate.factors.items() if f != 1.0]
            return (
                f"in spec ({self.found.verdict.level}) with "
                f"{', '.join(changed) or 'new settings alone'}: cost {candidate.cost:.3f}, "
                f"limited by {candidate.binding.replace('_', ' ')}"
            )
        nearest = self.nearest
        refused = f" (refused by the whole pipeline: {self.refused[0]})" if self.refused else ""
        return (
            f"no change within the bounds is in spec ({self.level}): "
            f"{nearest.binding.replace('_', ' ')} binds, at best {percent_used(nearest.ratio)} of "
            f"its limit in {self.screened}{refused}"
        )

    def _summary(self) -> Summary:
        names = list(self.space.names)
        titled = [("as it is", self.as_built), *self.known.items()]
        if self.found is not None:
            titled.append(("smallest change", self.found.candidate))
        rows = [candidate_cells(title, names, candidate) for title, candidate in titled]
        header = ["machine", *names, "cost", "of the limit", "limited by"]
        title = f"{self.job.name} on {self.machine.name}: {self.sentence()}"
        return Summary(title, header, rows)


def candidate_cells(title: str, names: Sequence[str], candidate: Candidate) -> list[str]:
    """Return title, factors, cost, share of the limit, and the criterion of a candidate."""
    return [
        title,
        *(f"{candidate.factors[name]:.3g}" for name in names),
        f"{candidate.cost:.2f}",
        percent_used(min(candidate.ratio, 999.0)),
        candidate.binding.replace("_", " "),
    ]


_RETRIED = 8  # number of settings of a known answer that are tried over the tolerances


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirements:
    """Requirements on a design, and options of its search.

    Parameters
    ----------
    trials
        The runs that prove the design: its level. The search tries candidates in as many runs.
        Only the proof covers other machines within the file's tolerances, or a yield: it tries
        candidates along the trade of cost for margin, and the cheapest that passes is the design.
    corners
        Whether the design must hold at every corner of the parameter tolerances, too.
    plotted
        Two parameters for the region; None: the two that cost most.
    smoothing_s
        Widths of the feed-forward smoothing; all widths from the least to the largest are
        searched. The commands then go through the exact inverse of each candidate, and no filters
        are designed for it. Empty for no feed-forward.
    effort
        Effort of the search; None: as much as the kind of machine allows.
    front
        Number of machines to draw of each candidate for the front of cost against yield; 0 for no
        front.
    searches
        Number of searches, each from random numbers of its own.
    """

    trials: Trials = REPEATED
    corners: bool = False
    plotted: tuple[str, str] | None = None
    smoothing_s: tuple[float, ...] = ()
    effort: Effort | None = None
    front: int = 0
    searches: int = 1


_BY_DEFAULT = Requirements()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Redesign:
    """A prepared redesign; its searches can be made all together, or some at a time.

    Parameters
    ----------
    machine, spec, options
        The machine to change, the specification that it has to meet, and how its job is planned.
    requirements
        Requirements on the design.
    space, evaluator
        The space of the candidates, and their judge.
    read
        Reads the job.
    """

    machine: Machine
    spec: Spec
    options: Options
    requirements: Requirements
    space: Space
    evaluator: Evaluator
    read: JobReader

    def searched(self, numbers: Sequence[int], progress: Progress | None = None) -> list[Search]:
        """Return the searches with these numbers, from 0."""
        return Searching(
            space=self.space,
            evaluator=self.evaluator,
            spec=self.spec,
            front=self.requirements.front,
            searches=self.requirements.searches,
        ).made(numbers, progress)

    def answer(self, searches: Sequence[Search], progress: Progress | None = None) -> DesignResult:
        """Return the answer of all searches, in the order of their numbers: prove the cheapest.

        Raises
        ------
        MachineError, PlanError
            If the job cannot be planned for the original machine.
        """
        space, evaluator, requirements = self.space, self.evaluator, self.requirements
        trials, candidates = requirements.trials, pooled(searches)
        simulated = sum(one.simulated for one in searches)
        simulated_before = evaluator.simulated
        proved_design, refused = proved(
            space, evaluator, candidates, self.spec, trials, requirements.corners
        )
        nearest = _nearest(space, candidates)
        centre = (
            candidates.points[nearest] if proved_design is None else _point(space, proved_design)
        )
        level = (
            int(candidates.level[nearest])
            if proved_design is None
            else _level(space, proved_design.candidate)
        )
        front = pareto(space, candidates, most_ratio(evaluator))
        used_logs = np.abs(
            candidates.points[front[candidates.ratio[front] <= 1.0], : space.parameters]
        )
        report: Callable[[float], None] = lambda _: None  # noqa: E731
        if progress is not None:
            bar = progress
            report = lambda share: bar("drawing the region", share)  # noqa: E731
        region = region_of(
            space,
            evaluator,
            centre,
            level,
            np.median(used_logs, axis=0) * space.weights if len(used_logs) else space.weights,
            requirements.plotted,
            report,
        )
        known = {
            name: _best_of(space, evaluator, candidates, point)
            for name, point in known_points(space).items()
        }
        as_built = _best_of(space, evaluator, candidates, np.zeros(space.parameters))
        return DesignResult(
            machine=self.machine,
            job=self.read(self.machine),
            space=space,
            found=proved_design,
            pareto=tuple(candidate_at(space, evaluator, candidates, i) for i in front.tolist()),
            known=known,
            as_built=as_built,
            region=region,
            nearest=candidate_at(space, evaluator, candidates, nearest),
            simulated=simulated + evaluator.simulated - simulated_before,
            level=trials.level,
            screened=evaluator.others.words,
            refused=refused,
            front=marked([one for search in searches for one in search.yields]),
        )


def redesign(
    job_file: Path,
    machine: Machine,
    spec: Spec,
    options: Options,
    requirements: Requirements = _BY_DEFAULT,
) -> Redesign:
    """Read the job for the original machine, and return the prepared redesign.

    Raises
    ------
    MachineError, JobError, PlanError, OptionError
        If the input is wrong, or no commands can be made for the original machine.
    """
    check_dynamics("what a change of its parts would do", machine)
    kind_of(machine).check_options(machine, options)
    space = design_space(machine, requirements.smoothing_s)
    read = JobReader.of(job_file, options)
    evaluator = Evaluator(
        space,
        read,
        spec,
        options,
        OtherRuns.of(space, requirements.trials, corners=requirements.corners),
        requirements.effort
        or (AHEAD if requirements.smoothing_s else FEW if space.serial else THOROUGH),
    )
    return Redesign(
        machine=machine,
        spec=spec,
        options=options,
        requirements=requirements,
        space=space,
        evaluator=evaluator,
        read=read,
    )


def design(
    job_file: Path,
    machine: Machine,
    spec: Spec,
    options: Options,
    requirements: Requirements = _BY_DEFAULT,
    progress: Progress | None = None,
) -> DesignResult:
    """Search the smallest change to ``machine`` that brings a job into ``spec``.

    Raises
    ------
    MachineError, JobError, PlanError, OptionError
        If the input is wrong, or no commands can be made for the original machine.
    """
    question = redesign(job_file, machine, spec, options, requirements)
    searches = question.searched(range(requirements.searches), within_progress(progress, 0.0, 0.75))
    return question.answer(searches, within_progress(progress, 0.75, 1.0))


def _nearest(space: Space, tried: Tried) -> int:
    """Return the cheapest candidate in spec, else the candidate with the least ratio."""
    in_spec = cheapest_first(space, tried)
    return int(in_spec[0]) if len(in_spec) else int(np.argmin(tried.ratio))


def _best_of(space: Space, evaluator: Evaluator, tried: Tried, parameters: FloatArray) -> Candidate:
    """Return the best tried candidate with the given parameters, over all settings."""
    same = np.abs(tried.points[:, : space.parameters] - parameters).max(axis=1) < 1e-9
    matching = tried.taken(np.flatnonzero(same))
    if evaluator.others.asked:
        # The first sample did not try further runs of expensive candidates that pass one run.
        points = with_settings(space, parameters, evaluator.effort.settings_log2)
        for level in range(len(space.levels)):
            levels = np.full(len(points), level, dtype=np.int64)
            matching = matching.join(evaluator.tried(points, levels, beyond=-1.0))
        best_indices = np.argsort(matching.nominal, kind="stable")[:_RETRIED]
        matching = evaluator.tried(
            matching.points[best_indices], matching.level[best_indices], beyond=np.inf
        )
    return candidate_at(space, evaluator, matching, int(np.argmin(matching.ratio)))


def _point(space: Space, found: ProvedDesign) -> FloatArray:
    candidate = found.candidate
    settings = []
    if candidate.crossover_hz is not None and candidate.phase_margin_deg is not None:
        settings = [np.log(candidate.crossover_hz), candidate.phase_margin_deg]
    if candidate.smoothing_s is not None:
        settings = [np.log(candidate.smoothing_s), candidate.acceleration]
    return np.array([*(np.log(candidate.factors[n]) for n in space.names), *settings])


def _level(space: Space, candidate: Candidate) -> int:
    return 0 if space.ahead else space.levels.index(candidate.acceleration)


def spec_file(machine_file: Path) -> Path:
    """Return the path of the specification that belongs to a machine file: beside the file."""
    return machine_file.with_suffix(_SPEC_SUFFIX)


def write_design(result: DesignResult, found: ProvedDesign, file: Path) -> list[Path]:
    """Write the machine file, and beside it the specification with the needle delay.

    Parameters
    ----------
    file
        Path of the machine file, ending in ``.toml``; the specification ends in ``.spec.toml``.

    Raises
    ------
    RecordingError
        If a file cannot be written.
    """
    texts = {
        file: machine_toml(result, found, file.parent),
        spec_file(file): spec_toml(found.spec, found.machine),
    }
    with together():
        for path, text in texts.items():
            with atomic_file(path) as stream:
                stream.write(text.encode())
    return list(texts)


def machine_toml(result: DesignResult, found: ProvedDesign, folder: Path) -> str:
    """Return the machine file of a design, based on the redesigned machine."""
    machine = result.machine
    texts = {
        path: quantity_text(number_at(machine, path), value)
        for path, value in found.numbers.items()
    }
    level = f" ({found.verdict.level})"
    if found.corners is not None:
        level += " and at the corners of the tolerances of [design]"
    lines = [
        f"# Found by threadline design for {ascii_only(result.job.name)}: in specification{level}.",
        f"# Cost {found.candidate.cost:.4g}: the sum of weight x |ln factor|.",
        f"base = {toml_string(_base(machine, folder))}",
        f"name = {toml_string(machine.name.split('+')[0] + '-redesigned')}",
        f"title = {toml_string(machine.title + ', redesigned')}",
        'design = "none"',
        *number_tables(texts),
    ]
    return "\n".join(lines) + "\n"


def quantity_text(old: Quantity, value: float) -> str:
    """Return a number as text of a machine file, with the same relative tolerance as ``old``."""
    spread = "exact"
    if old.tolerance_si and old.si:
        spread = f"+- {100.0 * abs(old.tolerance_si / old.si):.6g} %"
    new_text = f"{value!r} {old.unit}".strip()
    old_text = f"{old.si:.6g} {old.unit}".strip()
    return f"{new_text} {spread}, assumed: redesigned, from {old_text}"


def _base(machine: Machine, folder: Path) -> str:
    """Return the reference to the base machine, relative to ``folder``."""
    name, overlays = split_reference(machine.reference)
    if not name.endswith(".toml"):
        return machine.reference
    return "+".join([os.path.relpath(Path(name).resolve(), folder.resolve()), *overlays])


def spec_toml(spec: Spec, machine: Machine) -> str:
    """Return a specification as text of its file."""
    lines = [f"name = {toml_string(spec.name)}", f'lag = "{spec.lag_s!r} s"']
    given = {(c.name, c.axis) for c in spec.criteria if not c.hard}
    for criterion in spec.criteria:
        if criterion.hard and (criterion.name, criterion.axis) in given:
            continue  # the machine's own limit is narrower, and needs no line in the file
        measure = MEASURES[criterion.name]
        lines += ["", "[[criteria]]", f"name = {toml_string(criterion.name)}"]
        if criterion.axis:
            lines.append(f"axis = {toml_string(criterion.axis)}")
        if criterion.hard:
            lines.append('limit = "machine"')
        elif criterion.limit is not None:
            unit = measure.unit("rotary" if criterion.axis in machine.rotary else "linear")
            limit = f"{criterion.limit!r} {unit}"
            if not unit and criterion.limit > 1.0:  # a share above 100 % is read only with its unit
                limit = f"{100.0 * criterion.limit!r} %"
            lines.append(f"limit = {toml_string(limit.strip())}")
        if criterion.required:
            lines.append("required = true")
        for key, value in criterion.options.items():
            lines.append(f"{key} = {toml_string(f'{value!r} {measure.options[key].unit}'.strip())}")
    return "\n".join(lines) + "\n"
