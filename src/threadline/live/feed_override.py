"""The operator's override of the feed: its range, and the reasons for a refusal."""

from __future__ import annotations

from threadline.errors import CommandError
from threadline.live.states import State

LEAST_PERCENT = 10
"""Slowest override, %: the rates that are simulated before a run go down to it."""
MOST_PERCENT = 100
"""Fastest override, %: a plan is proven at its own feed, and at no faster one."""
STEP_PERCENT = 10
"""Step of an override by keys, %."""
MAY_OVERRIDE = frozenset({State.RUNNING, State.HOLDING})
"""States in which a run takes an override."""


def refuse_override(percent: int, state: State, forbidden: str) -> None:
    """Refuse an override beyond the proven range, outside of a run, or in a run that allows none.

    Parameters
    ----------
    percent
        The override, %.
    state
        State of the machine.
    forbidden
        Why the run allows none; empty if it does.

    Raises
    ------
    CommandError
        If the override is refused; the message says why.
    """
    if not LEAST_PERCENT <= percent <= MOST_PERCENT:
        raise CommandError(
            f"an override of {percent} % is not within the {LEAST_PERCENT} to {MOST_PERCENT} % "
            "that the proof covers",
            remedy="Prove the job with another feed to run it faster."
            if percent > MOST_PERCENT
            else "Hold the run to let it stand.",
        )
    if state not in MAY_OVERRIDE:
        raise CommandError(
            f"no run takes an override while the machine is {state.value}",
            remedy="Override the feed in a run.",
        )
    if forbidden:
        raise CommandError(f"the feed of this run cannot be overridden: {forbidden}")


def feed_words(percent: int) -> str:
    """Return an override in words, as recordings name it."""
    return f"feed {percent} %"
