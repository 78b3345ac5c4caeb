"""What is at the far end of a link to the simulated machine: one row for each kind of work.

The process of that machine takes this table alone: to plan and to judge is what others do.
"""

from __future__ import annotations

from threadline.live.sim_machine import SimMachine
from threadline.live.sim_rows import SimRows
from threadline.live.sim_scans import SimScans
from threadline.live.sim_turns import SimTurns
from threadline.machine import Machine

_SIMULATED: dict[str, type[SimMachine]] = {
    "ticks": SimRows,
    "switches": SimScans,
    "steps": SimTurns,
}
"""By the name of what machines are commanded by."""


def simulated_of(machine: Machine) -> type[SimMachine]:
    """Return the type of the simulated machine that does what ``machine`` does."""
    return _SIMULATED[machine.commanded_by]
