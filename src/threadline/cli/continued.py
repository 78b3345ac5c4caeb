"""Continuing a run that was broken off: which one, from where, and that somebody confirms it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from threadline.cli.operator_keys import somebody_at_the_keys
from threadline.cli.told import note
from threadline.errors import OptionError
from threadline.live.continuing import Continued, continued_by, last_executed, operation_at
from threadline.live.derived import Rest
from threadline.plan import Plan
from threadline.store.unfinished import refuse_other_rows, trace_of, unfinished_run

RestOf = Callable[[int], Rest]
ContinueOption = Annotated[
    str | None,
    typer.Option(
        "--continue",
        metavar="RUN",
        help="Do the rest of a run that was broken off (its name, or last): after homing and your "
        "confirmation the axes are moved to where the work begins again.",
    ),
]
AtOption = Annotated[
    str | None,
    typer.Option(
        help="Of --continue: where the work begins again: block (the one under way at the end), "
        'circuit, "circuit 12", "line 40".'
    ),
]
ConfirmedOption = Annotated[
    bool,
    typer.Option("--confirmed", help="Of --continue: go on without waiting for the key c."),
]


def check_continued(store: Path, run: str | None, at: str | None, *, confirmed: bool) -> None:
    """Refuse options of a continued run without one, no such run, and one that nobody confirms.

    Raises
    ------
    OptionError
        With what is missing.
    StoreError
        If there is no such run, or it came to its end.
    """
    if run is None:
        if at is not None or confirmed:
            raise OptionError(
                f"{'--at' if at is not None else '--confirmed'} is of --continue",
                remedy="Name the run to be continued, too.",
            )
        return
    unfinished_run(store, run)
    if not confirmed and not somebody_at_the_keys():
        raise OptionError(
            "--continue: nobody is at the keys to confirm that it may go on",
            remedy="Run it from a terminal, or with --confirmed.",
        )


def continued_run(
    store: Path, run: str | None, at: str | None, plan: Plan, rest_of: RestOf, *, asks: bool
) -> tuple[Continued | None, dict[str, str]]:
    """Return what is run, said to the operator, and what its recording tells of that.

    Both are empty where no run is continued.

    Parameters
    ----------
    store
        Folder of runs.
    run, at
        The run, and where the work begins again, as typed.
    plan
        The plan, which must be that of the run to the row.
    rest_of
        Returns the rest from an operation on, as the link is sent it.
    asks
        Whether the operator will be asked.

    Raises
    ------
    StoreError
        If there is no such run, it came to its end, or it was of other commands.
    """
    if run is None:
        return None, {}
    folder, record = unfinished_run(store, run)
    refuse_other_rows(record, plan)
    operation = operation_at(
        plan, last_executed(trace_of(folder, record)), "block" if at is None else at
    )
    again = continued_by(plan, rest_of(operation))
    for line in again.told:
        note(line)
    if asks:
        note("when it is home: c lets it go on, any other key ends it")
    return again, {"continues": folder.name, "from_operation": str(again.rest.operation)}
