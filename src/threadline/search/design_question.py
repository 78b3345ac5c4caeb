"""The question of a redesign, from the words of the command line or of Python."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.proof.option_words import parse_width_s
from threadline.proof.options import Options
from threadline.proof.pipeline import with_shaping
from threadline.proof.request import Words
from threadline.search.design import Requirements
from threadline.search.design_searches import MOST_SEARCHES
from threadline.verdict import Spec

MOST_FRONT = 1_000_000
_MOST_WIDTHS = 6
_SEARCHED = "10 ms, 80 ms"  # range of the smoothing widths if the user gave none


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignAims:
    """The options that only a redesign has.

    Parameters
    ----------
    corners, front, searches
        As in ``Requirements``.
    plot
        Two parameters for the region, as text.
    """

    corners: bool = False
    plot: str | None = None
    front: int = 0
    searches: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignQuestion:
    """A job, a machine, and the requirements of a redesign."""

    job: Path
    machine: Machine
    spec: Spec
    options: Options
    requirements: Requirements


def design_question(words: Words, job: Path, machine: Machine, aims: DesignAims) -> DesignQuestion:
    """Return the question of a redesign.

    Raises
    ------
    InputError
        If an option cannot be read, or two exclude each other.
    """
    for name, number, least, most in (
        ("front", aims.front, 0, MOST_FRONT),
        ("searches", aims.searches, 1, MOST_SEARCHES),
    ):
        if not least <= number <= most:
            raise OptionError(f"{name} must be from {least} to {most}, got {number}")
    known = tuple(machine.design.parameters) if machine.design else None
    plotted = _plotted(aims.plot, known)
    forward, contour = words.flag("feed_forward"), words.text("contour")
    smoothing_s = _widths_s(forward, words.text("smoothing"))
    if forward and contour is not None:
        raise OptionError(
            f"--contour {contour!r} bounds the path error of the motors, but with "
            "--feed-forward the loads follow the path, not the motors",
            remedy="Leave one of them out.",
        )
    # The search varies only the smoothing width; the other options of the plan stay the same.
    options = words.options(job, feed_forward=False, smoothing=None, robust=None)
    if words.text("robust") is not None:
        options = replace(options, robust_share=words.options(smoothing=None).robust_share)
    return DesignQuestion(
        job=job,
        machine=machine,
        spec=with_shaping(words.spec(machine), machine, options),
        options=options,
        requirements=Requirements(
            trials=words.trials(),
            corners=aims.corners,
            plotted=plotted,
            smoothing_s=smoothing_s,
            front=aims.front,
            searches=aims.searches,
        ),
    )


def _plotted(text: str | None, known: tuple[str, ...] | None) -> tuple[str, str] | None:
    if text is None or known is None:
        return None
    names = tuple(part.strip() for part in text.split(","))
    if len(names) != 2 or names[0] == names[1] or any(name not in known for name in names):
        raise OptionError(
            f"cannot plot {text[:60]!r}", remedy=f"Give two of {', '.join(known)}, with a comma."
        )
    return names[0], names[1]


def _widths_s(feed_forward: bool, text: str | None) -> tuple[float, ...]:
    """Return the least and the largest smoothing width, s; empty without feed-forward."""
    if not feed_forward:
        if text is not None:
            raise OptionError(
                f"--smoothing {text!r} needs feed-forward", remedy="Give --feed-forward too."
            )
        return ()
    parts = (_SEARCHED if text is None else text).split(",")
    widths_s = tuple(dict.fromkeys(parse_width_s(part.strip()) for part in parts))
    if len(widths_s) > _MOST_WIDTHS:
        raise OptionError(f"{len(widths_s)} smoothing widths, at most {_MOST_WIDTHS}")
    return widths_s
