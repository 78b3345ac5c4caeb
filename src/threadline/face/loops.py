"""Functions for control loops.

``analyse`` examines them, ``control`` designs state-space controllers, ``tune`` all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from threadline.base.arguments import checked
from threadline.base.writing import check_machine_output
from threadline.errors import OptionError
from threadline.face.answers import PathLike
from threadline.machine import Machine
from threadline.proof.python_arguments import in_arguments
from threadline.proof.request import chosen_machine

if TYPE_CHECKING:
    from threadline.dynamics.without_loop import Analysis
    from threadline.search.controller_design import ControlDesign
    from threadline.search.tuning import Tuning


@in_arguments
@checked
def analyse(machine: PathLike | Machine, axis: str | None = None) -> dict[str, Analysis]:
    """Return the analysis of each axis or cylinder, by its name.

    >>> from threadline.face import load_machine
    >>> analyse("lathe-winder", "X")["X"].verdict()
    'axis X: the loop is stable with up to 19 times the gain, phase margin 69.1 deg'

    Parameters
    ----------
    machine
        As ``load_machine`` takes it.
    axis
        The only axis or cylinder to analyse; None: all.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.dynamics.without_loop import analyse_moving

    chosen = chosen_machine(machine)
    if axis is not None and axis not in chosen.moving:
        raise OptionError(
            f"machine {chosen.name!r} has no axis {axis[:20]!r}",
            remedy=f"It has: {', '.join(chosen.moving)}.",
        )
    return {
        name: analyse_moving(chosen, name) for name in (chosen.moving if axis is None else [axis])
    }


@in_arguments
@checked
def control(
    machine: PathLike | Machine,
    design: str,
    out: PathLike,
    *,
    gain: float | None = None,
    sensors: Sequence[str] | None = None,
    ahead: int | None = None,
    smoothing: int | None = None,
    axes: Sequence[str] | None = None,
    direction: str | None = None,
    coupling: str | None = None,
) -> ControlDesign:
    """Design a state-space controller, and write a machine file with this controller.

    Parameters
    ----------
    machine
        As ``load_machine`` takes it.
    design
        ``"lqg"``, ``"preview"``, ``"zpetc"`` or ``"cross-coupled"``.
    out
        Machine file to write, based on ``machine``.
    gain, sensors
        Static gain as a multiple of the static gain of the present controllers, and sensors to read
        besides the encoders; not for ``"cross-coupled"``.
    ahead
        Number of future references that ``"preview"`` knows.
    smoothing
        Number of references in each moving average of ``"zpetc"``, an odd number.
    axes, direction, coupling
        For ``"cross-coupled"``: the two axes; the direction of the line, such as ``"45 deg"``; the
        additional weight of the error across the line, such as ``"50 %"``.

    Raises
    ------
    InputError
        As on the command line; nothing is written then.
    """
    from threadline.search.controller_design import DesignGoal, design_controllers

    goal = DesignGoal(
        design=design,
        gain=gain,
        sensors=None if sensors is None else tuple(sensors),
        ahead=ahead,
        smoothing=smoothing,
        axes=None if axes is None else tuple(axes),
        direction=direction,
        coupling=coupling,
    )
    return design_controllers(chosen_machine(machine), goal, Path(out))


@in_arguments
@checked
def tune(
    machine: PathLike | Machine,
    out: PathLike | None = None,
    *,
    axis: str | None = None,
    margin: str = "60 deg",
    crossover: str | None = None,
    jobs: Sequence[PathLike] = (),
    controller: str | None = None,
    rule: str = "margin",
) -> Tuning:
    """Design controllers of five kinds for the loops of a machine, by four rules.

    Only the machine file is used; the machine does not move.

    Parameters
    ----------
    machine
        As ``load_machine`` takes it.
    out
        Machine file to write, with the controllers that ``controller`` and ``rule`` name.
    axis
        The only axis to tune; None: all.
    margin
        Phase margin for the rule ``"margin"``.
    crossover
        Crossover frequency for the rule ``"margin"``, such as ``"13.5 Hz"``; None for the crossover
        with the largest gain at low frequencies.
    jobs
        Jobs to simulate with each controller.
    controller
        ``"p"``, ``"pi"``, ``"pd"``, ``"pid"`` or ``"lead"``; None for the machine's own.
    rule
        ``"margin"``, ``"ultimate"``, ``"step"`` or ``"settling"``.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.search.tune import (
        parse_controller,
        parse_rule,
        tuning_goal,
        usual_controller,
        write_tuned,
    )
    from threadline.search.tune import tune as tune_machine

    chosen = chosen_machine(machine, None)
    kind = usual_controller(chosen) if controller is None else parse_controller(controller)
    by = parse_rule(rule)
    if out is not None:
        check_machine_output(Path(out))
    found = tune_machine(
        chosen, tuning_goal(chosen, axis, margin, crossover), [Path(job) for job in jobs]
    )
    if out is not None:
        write_tuned(found, kind, by, Path(out))
    return found
