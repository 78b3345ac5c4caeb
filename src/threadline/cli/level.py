"""The level of a verdict on the command line: which runs it is made of."""

from __future__ import annotations

from typing import Annotated

import typer

from threadline.errors import OptionError
from threadline.pipeline import NOMINAL, REPEATED, TOLERANCES, Trials

NominalOption = Annotated[
    bool,
    typer.Option(
        "--nominal", help="One run of the machine as its file says; it says nothing of the next."
    ),
]
RepeatsOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=1000,
        help="So many runs with other encoder phases, friction and supply; 20 unless said.",
    ),
]
TolerancesOption = Annotated[
    bool,
    typer.Option(
        "--tolerances",
        help="Other machines within the +- of the machine file, too: 200 of them.",
    ),
]


def level_words(trials: Trials) -> str:
    """Return the option that asks for a level again; empty for the one that is meant anyway."""
    if trials == REPEATED:
        return ""
    if trials.machines:
        return "--tolerances"
    return "--nominal" if trials == NOMINAL else f"--repeats {trials.repeats}"


def trials_of(nominal: bool, repeats: int | None, tolerances: bool) -> Trials:
    """Return which runs are asked for.

    Raises
    ------
    OptionError
        If more than one level is.
    """
    given = {"--nominal": nominal, "--repeats": repeats is not None, "--tolerances": tolerances}
    asked = [name for name, value in given.items() if value]
    if len(asked) > 1:
        raise OptionError(
            f"{' and '.join(asked)} ask for different levels", remedy="Give one of them."
        )
    if repeats is not None:
        return Trials(repeats=repeats)
    return NOMINAL if nominal else TOLERANCES if tolerances else REPEATED
