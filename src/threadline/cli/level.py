"""Options for the level of a verdict: how many runs and machines it is made of."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import typer

from threadline.errors import OptionError
from threadline.option_defaults import MOST_REPEATS
from threadline.option_words import parse_ends
from threadline.pipeline import NOMINAL, REPEATED, TOLERANCES, Trials, yielding
from threadline.typed_number import parse_number

NominalOption = Annotated[
    bool,
    typer.Option(
        "--nominal", help="Judge one run of the machine as its file says; the next may differ."
    ),
]
RepeatsOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=MOST_REPEATS,
        help="How many runs, each with other encoder phases, friction and supply; default 20.",
    ),
]
TolerancesOption = Annotated[
    bool,
    typer.Option(
        "--tolerances",
        help="Judge 200 other machines within the tolerances of the machine file, too.",
    ),
]


YieldOption = Annotated[
    str | None,
    typer.Option(
        "--yield",
        help='Share of the machines within the tolerances that must be in spec: "99 %", judged '
        "by the lower end of the exact 95 % interval of 1000 of them.",
    ),
]


EndsOption = Annotated[
    str | None,
    typer.Option(
        "--ends",
        help="Judge the machines with loads and springs at the ends of this share of their "
        'tolerances, too, one run each: "100 %".',
    ),
]


def level_option(trials: Trials) -> dict[str, str]:
    """Return the options that give the level ``trials``, with values; none for the default."""
    if trials.ends is not None:
        ends = {"--ends": f"{100.0 * trials.ends:.12g} %"}
        return level_option(replace(trials, ends=None)) | ends
    if trials == REPEATED:
        return {}
    if trials.wished is not None:
        return {"--yield": f"{100.0 * trials.wished:.12g} %"}
    if trials.machines:
        return {"--tolerances": ""}
    if trials == NOMINAL:
        return {"--nominal": ""}
    return {"--repeats": f"{trials.repeats}"}


def level_words(trials: Trials) -> str:
    """Return the option that gives the level ``trials`` as text; empty for the default level.

    >>> level_words(yielding(0.99))
    '--yield "99 %"'
    """
    words = [f'{name} "{value}"' if " " in value else f"{name} {value}".strip()
             for name, value in level_option(trials).items()]  # fmt: skip
    return " ".join(words)


def trials_of(
    nominal: bool,
    repeats: int | None,
    tolerances: bool,
    wished: str | None = None,
    ends: str | None = None,
) -> Trials:
    """Return the level that the options ask for: its number of runs and of machines.

    Raises
    ------
    OptionError
        If more than one level is, or the wished yield is no share.
    """
    given = {
        "--nominal": nominal,
        "--repeats": repeats is not None,
        "--tolerances": tolerances,
        "--yield": wished is not None,
    }
    asked = [name for name, value in given.items() if value]
    if len(asked) > 1:
        raise OptionError(
            f"{' and '.join(asked)} ask for different levels", remedy="Give one of them."
        )
    level = NOMINAL if nominal else TOLERANCES if tolerances else REPEATED
    if wished is not None:
        level = yielding(parse_yield(wished))
    elif repeats is not None:
        level = Trials(repeats=repeats)
    return level if ends is None else replace(level, ends=parse_ends(ends))


def parse_yield(text: str) -> float:
    """Return a wished yield such as ``"99 %"`` as a share.

    Raises
    ------
    OptionError
        If it is not above 0 % and below 100 %: no number of machines proves 100 %.
    """
    value = parse_number("yield", text, "", "99 %")
    if not 0.0 < value < 1.0:
        raise OptionError(
            f"yield {text!r} must be above 0 % and below 100 %",
            remedy='99 of 100 machines in spec is "99 %"; no number of machines proves 100 %.',
        )
    return value
