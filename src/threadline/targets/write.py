"""The targets: what a plan can be written as, by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from threadline.errors import OptionError
from threadline.signals import Commands, TickTable
from threadline.signals.files_array import write_array
from threadline.signals.files_common import Written, nearest
from threadline.signals.files_table import write_table_csv, write_table_npz
from threadline.targets.calculate import CompiledPlan

TableWriter = Callable[[TickTable, Path], Written]

TABLES: dict[str, TableWriter] = {
    "csv": write_table_csv,
    "npz": write_table_npz,
    "ticks": write_array,
}
"""Targets that need the tick table alone."""


def target_names() -> tuple[str, ...]:
    """Return the names of all targets."""
    return tuple(sorted([*TABLES]))


def write(plan: CompiledPlan | Commands, target: str, out: str | Path) -> list[Written]:
    """Write ``plan`` for a controller; whole files or none.

    Parameters
    ----------
    plan
        A plan, or for ``csv``, ``npz`` and ``ticks`` the commands alone.
    target
        ``csv``: every tick on a line. ``npz``: the same as arrays. ``ticks``: the trajectory
        array of the 1994 controller.
    out
        The file.

    Returns
    -------
    list of Written
        The files with their hashes.

    Raises
    ------
    OptionError
        If there is no such target.
    PlanError
        If the commands break a limit; nothing is written then.
    """
    writer = TABLES.get(target)
    if writer is None:
        raise OptionError(f"unknown target {target[:40]!r}", remedy=nearest(target, target_names()))
    commands = getattr(plan, "commands", plan)
    if not isinstance(commands, TickTable):
        raise OptionError(
            f"target {target!r} takes a tick table, not a {type(commands).__name__}",
            remedy="Choose a target for this kind of machine.",
        )
    return [writer(commands, Path(out))]
