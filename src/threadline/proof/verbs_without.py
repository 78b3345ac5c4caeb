"""Why a verb does not take an option, and what to use instead.

Every verb takes every option that means something for it. For every other pair of option and verb
this table has the reason, which refusals and the reference page give.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Without:
    """Verbs that do not take an option.

    Parameters
    ----------
    verbs
        Their names, as in the table of options.
    why
        The reason, as the end of a sentence.
    instead
        What to do instead.
    """

    verbs: tuple[str, ...]
    why: str
    instead: str


LEAVE_OUT = "Leave it out."
_TO_PROVE, _TO_FASTEST = "Give it to prove.", "Give it to fastest."
_WRITES = Without(("compile",), "it writes the plan and judges no run", _TO_PROVE)
_READS = Without(("equal",), "it compares files with the plan and judges no run", _TO_PROVE)
_RECORDED = Without(("judge",), "it judges recorded runs and simulates none", _TO_PROVE)
_FILMED = Without(("animate",), "it shows one run", _TO_PROVE)
_DRAWN = Without(("yield",), "it judges drawn machines in one run each", _TO_PROVE)
_UNJUDGED = (_WRITES, _READS)
_OTHER_LEVEL = (*_UNJUDGED, _RECORDED, _FILMED, _DRAWN)
_AS_DRAWN = 'Give it to prove, with --yield "99 %" if a share of all machines is wanted.'
_BEYOND = Without(("yield",), "its share counts drawn machines, and these are not drawn", _AS_DRAWN)
_NO_SEARCH = ("prove", "run", "compile", "equal", "yield", "animate", "judge", "panel")
_AGAIN = Without(
    ("compile", "equal", "yield", "animate", "judge", "panel"),
    "it searches nothing, and this searches again on nine machines",
    _TO_FASTEST,
)
_OF_ENDS = 'Give --ends "100 %" to judge the machines there.'

WITHOUT: Mapping[str, tuple[Without, ...]] = {
    "spec": (
        *_UNJUDGED,
        Without(
            ("panel",),
            "one specification applies to all programs of a panel",
            "Give it to threadline panel at its start.",
        ),
    ),
    "par": (
        Without(
            ("panel",),
            "the machine of a panel does not change",
            "Give it to threadline panel at its start.",
        ),
    ),
    "actual": (
        _WRITES,
        _READS,
        Without(
            ("design",),
            "the changed machine both plans and runs the job",
            "Redesign that machine.",
        ),
        Without(
            ("panel",),
            "the machine of the panel itself runs the plan",
            _TO_PROVE,
        ),
    ),
    "law": (
        Without(
            ("compare",),
            "it compares laws as interpolations",
            'Give --interpolation "law:NAME,law:OTHER".',
        ),
    ),
    "feed": (Without(("fastest",), "it searches the feed", "Bound it with --low and --high."),),
    "needle": (
        Without(
            ("fastest",), "it searches the speed of the needle", "Bound it with --low and --high."
        ),
    ),
    "limits": (
        Without(
            ("fastest",),
            "it searches the share of the limits",
            "Read the share from its answer, and give that to prove.",
        ),
    ),
    "product": (
        Without(
            ("compile", "equal"),
            "a product is for the judgement of the fibre, and no command depends on it",
            _TO_PROVE,
        ),
    ),
    "table": (
        Without(
            ("compare",),
            "a learned table is valid for one plan, and it makes several",
            _TO_PROVE,
        ),
        Without(
            ("fastest",),
            "a learned table is valid for one plan, and it makes many",
            "Give --learned 5: every plan is judged with the table that five repeats learn.",
        ),
        Without(
            ("design",),
            "a learned table is valid for one machine file, and it changes the machine",
            "Learn on the changed machine.",
        ),
        Without(
            ("panel",),
            "a panel shows every option as a short text, and a table is long",
            "Give it to run.",
        ),
    ),
    "mode": (
        Without(
            ("fastest",),
            "it makes the commands for the modes of the simulated machine, and commands for "
            "another mode could only be slower",
            'Give --band "20 %" for modes that are not known exactly, or --actual for another '
            "machine.",
        ),
        Without(
            ("learn",), "it corrects control loops, and an on/off machine has none", LEAVE_OUT
        ),
    ),
    "level": _OTHER_LEVEL,
    "nominal": (
        *_OTHER_LEVEL,
        Without(("panel",), "its level is a choice of the page", "Give level: nominal."),
    ),
    "repeats": (
        *_OTHER_LEVEL,
        Without(
            ("learn",),
            "its own --repeats is how often the job is repeated to learn",
            "Give the learned table to prove, with --repeats.",
        ),
        Without(("panel",), "its levels have a fixed number of runs", _TO_PROVE),
    ),
    "tolerances": (
        *_OTHER_LEVEL,
        Without(("panel",), "its level is a choice of the page", "Give level: over tolerances."),
    ),
    "yield": (
        *_UNJUDGED,
        _RECORDED,
        _FILMED,
        Without(
            ("yield",),
            "its answer is the yield itself",
            "Compare the answer with the wanted share, or give the share to prove.",
        ),
    ),
    "ends": (*_UNJUDGED, _RECORDED, _FILMED, _BEYOND),
    "band": (*_UNJUDGED, _RECORDED, _FILMED, _BEYOND),
    "margin": (
        Without(("compile", "equal"), "it judges no run", _TO_FASTEST),
        Without(
            ("prove", "run", "compare", "yield", "animate", "judge", "learn", "panel"),
            "it judges by the limits of the specification as they are",
            "Give a specification with lower limits, or give it to fastest.",
        ),
        Without(
            ("design",),
            "it writes the specification that the changed machine meets",
            "Give a specification with lower limits.",
        ),
    ),
    "low": (
        Without((*_NO_SEARCH, "learn"), "it searches no feed", _TO_FASTEST),
        Without(("compare",), "it searches the whole range of feeds", _TO_FASTEST),
        Without(("design",), "it searches the machine and not the feed", _TO_FASTEST),
    ),
    "learned": (
        Without(
            (*_NO_SEARCH, "compare", "design"),
            "it learns nothing",
            "Give the repeats to learn, or give it to fastest.",
        ),
        Without(("learn",), "it has the number of repeats as an option", "Give --repeats."),
    ),
    "mismatch": (
        _AGAIN,
        Without(
            ("prove", "run", "compare", "design"),
            "it searches no feed, and this searches the feed again on nine machines",
            _OF_ENDS,
        ),
        Without(
            ("learn",),
            "it searches no feed, and this searches the feed again on nine machines",
            'Give --ends "100 %" to learn on the machines there.',
        ),
    ),
    "within": (
        Without((*_NO_SEARCH, "compare", "learn"), "its number of runs is fixed", _TO_FASTEST),
        Without(
            ("design",),
            "its number of tries is fixed, so that the answer does not depend on the computer",
            "Give fewer --searches.",
        ),
    ),
    "cluster": (
        Without(("compile", "equal", "animate", "judge"), "it judges no machines", LEAVE_OUT),
        Without(
            ("run", "panel"),
            "the machine would wait for another computer",
            _TO_PROVE,
        ),
    ),
}  # fmt: skip
"""By the name of an option; ``damping`` is as ``mode``, and ``high`` as ``low``."""
_AS = {"damping": "mode", "high": "low"}


def reasons(option: str) -> tuple[Without, ...]:
    """Return the verbs that do not take an option, with the reasons.

    >>> [one.verbs for one in reasons("law")]
    [('compare',)]
    """
    return WITHOUT.get(_AS.get(option, option), ())


def reason(option: str, verb: str) -> Without | None:
    """Return why a verb does not take an option; None if it takes it, or plans no job.

    >>> reason("law", "compare").why
    'it compares laws as interpolations'
    """
    return next((one for one in reasons(option) if verb in one.verbs), None)
