"""Questions about many machines: the share that is in specification, and the smallest change."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from threadline.base.arguments import checked
from threadline.errors import OptionError
from threadline.face.answers import PathLike
from threadline.machine import Machine
from threadline.proof.option_form import Door, Word
from threadline.proof.python_arguments import with_options
from threadline.proof.request import Words

if TYPE_CHECKING:
    from threadline.search.design import DesignResult
    from threadline.search.machine_yield import Yield

__all__ = ["design", "yields"]


@with_options
@checked
def yields(
    job: PathLike,
    machine: PathLike | Machine,
    *,
    variants: int = 10_000,
    seed: int = 1,
    **words: Word,
) -> Yield:
    """Draw machines within the tolerances of the machine file, and judge each in one run.

    Parameters
    ----------
    job, machine
        As ``prove`` takes them.
    variants, seed
        Number of machines to draw, and the seed of their random sequence.
    **words
        The options of ``threadline yield``. ``cluster`` names the scheduler whose workers judge the
        machines.

    Raises
    ------
    InputError
        As on the command line.
    LinkFaultError
        If the cluster fails.
    """
    from threadline.search.machine_yield import planned_yield
    from threadline.search.yield_parts import MOST_VARIANTS

    for name, value, least, most in (
        ("variants", variants, 1, MOST_VARIANTS),
        ("seed", seed, 0, 2**64 - 1),
    ):
        if not least <= value <= most:
            raise OptionError(f"{name} must be from {least} to {most}")
    given = Words.of("yield", Door.PYTHON, words)
    with given.judging():
        judged, _ = planned_yield(given, Path(job), given.machine(machine))
        return judged.drawn(variants, seed)


@with_options
@checked
def design(
    job: PathLike,
    machine: PathLike | Machine,
    *,
    corners: bool = False,
    plot: str | None = None,
    front: int = 0,
    searches: int = 1,
    **words: Word,
) -> DesignResult:
    """Find the smallest change to the machine with which a job is in specification.

    Parameters
    ----------
    job, machine
        As ``prove`` takes them.
    corners
        Whether the design must also pass at every corner of the tolerances in ``[design]``.
    plot
        The two parameters over which the region in specification is plotted, ``"belt,load"``.
    front
        Number of machines to draw for each candidate on the Pareto front of cost and yield; 0 for
        no front.
    searches
        Number of searches with different random numbers; the result is the best of their designs.
    **words
        The options of ``threadline design``. ``cluster`` names the scheduler whose workers judge
        the candidates.

    Raises
    ------
    InputError
        As on the command line.
    LinkFaultError
        If the cluster fails.
    """
    from threadline.search.design import design as search
    from threadline.search.design_question import DesignAims, design_question

    given = Words.of("design", Door.PYTHON, words)
    aims = DesignAims(corners=corners, plot=plot, front=front, searches=searches)
    with given.judging():
        question = design_question(given, Path(job), given.machine(machine), aims)
        return search(
            question.job, question.machine, question.spec, question.options, question.requirements
        )
