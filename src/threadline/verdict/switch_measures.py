"""Measures of an on/off machine: ringing after each step, and the limits of the valves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.dynamics.pneumatic import step_ringing
from threadline.files import ChannelKind
from threadline.verdict.finding import Finding, Hidden
from threadline.verdict.switch_run import RunStep, SwitchRun, sample_at

_LEAST_PERIODS = 0.5  # a shorter part does not show both extremes of the ringing
_BY_SPEED_PERIODS = 0.05  # enough for position and speed of the ringing
_INSTANT_S = 1e-9
_STOP_GIVES_M = 1.5e-4
"""Largest depth by which a piston compresses its end stop; then it oscillates with its cylinder.

7 kg at 0.43 m/s compress a beam of 1e8 N/m by v sqrt(m / k) = 0.114 mm. For a rotary cylinder this
is the depth at its radius.
"""


def _unknown(run: SwitchRun, axis: str = "") -> list[Finding]:
    at = len(run.row_s)
    note = f"the outputs leave the schedule after {at} of its {len(run.commands.ticks)} switchings"
    return [Finding(value=None, axis=axis, note=note)]


def residual_vibration(run: SwitchRun, options: Mapping[str, float]) -> list[Finding]:
    """Per step and cylinder: half the peak-to-peak motion of its frame, m, once it rests.

    It is measured from ``after`` s after the cylinder has come to rest, for ``window`` s or until
    the cylinder moves again. Ringing left from earlier moves counts too. Less than half a period
    does not show both extremes: then the amplitude is computed from position and speed of the
    frame, with which it would ring on until a later move.
    """
    found: list[Finding] = []
    for axis in run.plan.job.axes:
        frame = run.find(ChannelKind.FRAME, axis)
        if frame is None:
            note = run.why(ChannelKind.FRAME, axis)
            found.append(Finding(value=None, axis=axis, note=note))
        elif not run.steps:
            found += _unknown(run, axis)
        else:
            pole = step_ringing(run.plan.machine, axis).pole
            found += [_ringing(run, step, axis, frame, pole, options) for step in run.steps]
    return found


def _ringing(
    run: SwitchRun,
    step: RunStep,
    axis: str,
    frame: tuple[FloatArray, FloatArray],
    pole: complex,
    options: Mapping[str, float],
) -> Finding:
    begin_s, end_s = run.quiet_s(step, axis)
    begin_s += options["after"]
    end_s = min(end_s, begin_s + options["window"])
    time_s, values = frame
    blank = Finding(value=None, axis=axis, step=step.name, operation=step.operation)
    why = run.ends_too_early(time_s, min(end_s, run.due_s(step, axis)))
    if why:
        return replace(blank, note=why)
    period_s = 2.0 * np.pi / abs(pole)
    seen = (end_s - begin_s) / period_s
    if seen < -_INSTANT_S / period_s:
        when = " and been watched" if options["after"] else ""
        return replace(blank, note=f"it moves again before it has come to rest{when}")
    if seen < _LEAST_PERIODS:
        return _by_speed(blank, frame, begin_s, end_s, pole)
    inside = _between(time_s, begin_s, end_s)
    if inside.stop - inside.start < 2:
        return replace(blank, note="it is recorded too seldom to see what rings")
    part = values[inside]
    rest = 0.5 * (part.max() + part.min())
    amplitude_m = 0.5 * float(np.ptp(part))
    return replace(
        blank,
        value=amplitude_m,
        hidden=run.hidden_ringing(axis, pole, amplitude_m),
        time_s=float(time_s[inside.start + int(np.argmax(np.abs(part - rest)))]),
        note="" if seen >= 1.0 else f"{seen:.2f} of a period is seen before it moves again",
    )


def _by_speed(
    blank: Finding,
    frame: tuple[FloatArray, FloatArray],
    begin_s: float,
    end_s: float,
    pole: complex,
) -> Finding:
    """Return the amplitude of a frame that is seen too briefly, from its position and speed.

    The frame rings about its position before the cycle, as ``Re(a exp(pole t))``; ``a`` is fitted
    to the samples by least squares.
    """
    time_s, values = frame
    least_s = _BY_SPEED_PERIODS * 2.0 * np.pi / abs(pole)
    inside = _between(time_s, min(begin_s, end_s - least_s), end_s)
    if inside.stop - inside.start < 3:
        return replace(blank, note="it moves again too soon for how seldom it is recorded")
    wave = np.exp(pole * (time_s[inside] - begin_s))
    rows = np.column_stack((wave.real, -wave.imag))
    real, imag = np.linalg.lstsq(rows, values[inside] - values[0], rcond=None)[0]
    seen = max(end_s - begin_s, 0.0) / (2.0 * np.pi / abs(pole))
    return replace(
        blank,
        value=float(np.hypot(real, imag)),
        time_s=float(begin_s),
        note=f"by its place and speed: it moves again after {seen:.2f} of a period",
    )


def _between(times_s: FloatArray, begin_s: float, end_s: float) -> slice:
    """Return the samples between two instants, both included."""
    first = int(np.searchsorted(times_s, begin_s, side="left"))
    return slice(first, max(first, int(np.searchsorted(times_s, end_s, side="right"))))


def settling_time(run: SwitchRun, options: Mapping[str, float]) -> list[Finding]:
    """Per step: time from its last cylinder switching until every frame stays in the band, s.

    The band is centred on each frame's position before the cycle. A frame that is still outside the
    band when its cylinder moves again never settles.
    """
    axes = run.plan.job.axes
    frames = {axis: run.find(ChannelKind.FRAME, axis) for axis in axes}
    missing = [axis for axis, frame in frames.items() if frame is None]
    if missing:
        note = "; ".join(run.why(ChannelKind.FRAME, axis) for axis in missing)
        return [Finding(value=None, note=note)]
    if not run.steps:
        return _unknown(run)
    poles = {axis: step_ringing(run.plan.machine, axis).pole for axis in axes}
    shares = {axis: run.largest_share(axis, poles[axis]) for axis in axes}
    coarsest = max((run.hidden_ringing(axis, poles[axis], 0.0) for axis in axes), key=_most)
    found = []
    for step in run.steps:
        ends = [m.end_s for m in run.moves if step.begin_s - 1e-9 <= m.begin_s < step.end_s - 1e-9]
        if not ends:
            continue  # nothing moved
        last_s = max(ends)
        worst, why = Finding(value=-1.0), ""
        for axis, frame in frames.items():
            assert frame is not None
            time_s, values = frame
            why = why or run.ends_too_early(time_s, run.due_s(step, axis))
            inside = _between(time_s, last_s, run.quiet_s(step, axis)[1])
            # A frame may leave the band between two samples; too few say nothing of it.
            seen_m = options["band"] * (shares[axis] or 1.0)
            out = np.flatnonzero(np.abs(values[inside] - values[0]) > seen_m)
            settled = float(time_s[inside.start + out[-1]]) - last_s if len(out) else 0.0
            never = bool(len(out)) and inside.start + int(out[-1]) + 1 == inside.stop
            value = float("inf") if never else settled
            if worst.value is None or value > worst.value:
                note = f"{axis} rings on until it moves again" if never else axis
                worst = Finding(
                    value=value,
                    step=step.name,
                    operation=step.operation,
                    time_s=last_s + settled,
                    note=note if settled else "",
                )
        found.append(replace(worst, unseen=why, hidden=coarsest))
    return found


def _most(hidden: Hidden) -> float:
    return hidden.most


def end_position_error(run: SwitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Per step and cylinder that moves in it: final distance from its target, m."""
    found: list[Finding] = []
    for axis in run.plan.job.axes:
        load = run.find(ChannelKind.LOAD, axis)
        if load is None:
            note = run.why(ChannelKind.LOAD, axis)
            found.append(Finding(value=None, axis=axis, note=note))
            continue
        if not run.steps:
            found += _unknown(run, axis)
        for move in run.moves_of(axis):
            step = next(s for s in reversed(run.steps) if s.begin_s <= move.begin_s + 1e-9)
            # A later step may move it again: its position before that move counts.
            later = [m.begin_s for m in run.moves_of(axis) if m.begin_s > move.begin_s]
            end_s = min([run.quiet_s(step, axis)[1], *later])
            why = run.ends_too_early(load[0], run.due_s(step, axis))
            if why:
                operation = move.planned.operation
                found.append(
                    Finding(value=None, axis=axis, step=step.name, operation=operation, note=why)
                )
                continue
            at = sample_at(load[0], end_s)
            found.append(
                Finding(
                    value=abs(float(load[1][at]) - move.target_m),
                    axis=axis,
                    step=step.name,
                    time_s=float(load[0][at]),
                    operation=move.planned.operation,
                )
            )
    return found


def repeatability(runs: Sequence[SwitchRun], options: Mapping[str, float]) -> Sequence[Finding]:
    """Largest distance of a piston's position after a move from the mean over all runs, m.

    Angles of a rotary cylinder count at its radius. Each run is read at its own instants, so a run
    that waited longer is compared at the end of the same move.
    """
    least_count = max(int(options["recordings"]), 2)
    if len(runs) < least_count:
        return [Finding(value=None, note=f"needs {least_count} recordings, has {len(runs)}")]
    places = []
    for number, run in enumerate(runs, start=1):
        if not run.steps:
            return [replace(_unknown(run)[0], note=f"recording {number}: {_unknown(run)[0].note}")]
        ends = run.ends
        if isinstance(ends, str):
            return [Finding(value=None, note=f"recording {number}: {ends}")]
        places.append(ends)
    if not places[0]:
        return [Finding(value=None, note="no cylinder moves")]
    cylinders = runs[0].plan.machine.cylinders
    radii = (cylinders[move.planned.axis].radius for move in runs[0].moves)
    at_tool = np.array([1.0 if radius is None else radius.si for radius in radii])
    stands = at_tool * np.array([[place for place, _ in ends] for ends in places])
    away = np.abs(stands - stands.mean(axis=0))
    worst, move = np.unravel_index(int(np.argmax(away)), away.shape)
    planned = runs[int(worst)].moves[int(move)].planned
    return [
        Finding(
            value=float(away[worst, move]),
            time_s=places[int(worst)][int(move)][1],
            operation=planned.operation,
            note=f"{planned.step}: {planned.axis}, recording {int(worst) + 1}",
        )
    ]


def travel(run: SwitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Per cylinder: distance of the piston beyond its stroke, m; negative while room is left.

    At an end stop it is 0, including the tenth of a millimetre by which the stop gives way.
    """
    found = []
    for axis in run.plan.job.axes:
        load = run.find(ChannelKind.LOAD, axis)
        if load is None:
            note = run.why(ChannelKind.LOAD, axis)
            found.append(Finding(value=None, axis=axis, note=note))
            continue
        cylinder = run.plan.machine.cylinders[axis]
        beyond = np.maximum(load[1] - cylinder.stroke.si, -load[1])
        at = int(np.argmax(beyond))
        gives = _STOP_GIVES_M / (1.0 if cylinder.radius is None else cylinder.radius.si)
        value = 0.0 if 0.0 <= beyond[at] <= gives else float(beyond[at])
        why = run.ends_too_early(load[0], run.end_s) if run.followed else ""
        note = "beyond an end of its stroke" if value > 0.0 else ""
        found.append(
            Finding(value=value, axis=axis, time_s=float(load[0][at]), note=note, unseen=why)
        )
    return found


def cycle_time(run: SwitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Time from the start to the end of the last step, s: with waits for inputs, without holds.

    If there are a first and a further cycle, the further cycle counts.
    """
    if not run.steps:
        return _unknown(run)
    if run.unseen_wait:
        return [Finding(value=None, note=run.unseen_wait)]
    begin_s, end_s = run.steps[0].begin_s, run.steps[-1].end_s
    again = run.plan.scheduled.steady_tick
    if again:
        begin_s = run.instant_s(again)
    held_s = run.held_s(begin_s, end_s)
    note = f"without {held_s:.6g} s in which it was held" if held_s else ""
    return [Finding(value=end_s - begin_s - held_s, time_s=end_s, note=note)]


def switching_order(run: SwitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Share of the switchings of the schedule that are missing or out of order."""
    total = len(run.commands.ticks)
    if run.followed:
        return [Finding(value=0.0)]
    at = len(run.row_s)
    operation = int(run.commands.operation[at])
    return [
        Finding(
            value=(total - at) / total,
            time_s=run.left_s,
            operation=operation,
            note=f"{at} of {total} switchings follow the schedule",
        )
    ]


def switching_error(run: SwitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Largest error of the time between two switchings of one move, s."""
    if not run.followed:
        return _unknown(run)
    period_s = float(run.commands.clock.period_s)
    worst = Finding(value=0.0)
    for move in run.moves:
        ticks = [move.planned.first_tick + t for t in move.planned.levels.ticks]
        for tick in ticks[1:]:
            error = abs(run.instant_s(tick) - move.begin_s - (tick - ticks[0]) * period_s)
            if error > (worst.value or 0.0) + 1e-9:
                worst = Finding(
                    value=error, time_s=run.instant_s(tick), operation=move.planned.operation
                )
    return [worst]


def switching_dwell(run: SwitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Time by which a valve switched again too soon, s; 0 if no valve did.

    The note names the valve with the shortest rest, its rest, and the rest that it needs.
    """
    machine = run.plan.machine
    assert machine.plc is not None
    valves = [
        i for i, n in enumerate(run.commands.outputs) if machine.outputs[n].kind in _VALVE_KINDS
    ]
    worst = Finding(value=None, note="no valve switches twice")
    need_s, shortest_s = machine.plc.dwell.si, np.inf
    for column in valves:
        values = run.states[:, column]
        at = np.flatnonzero(np.diff(values, prepend=0))
        if len(at) < 2:
            continue
        spans = np.diff(run.time_s[at])
        short = int(np.argmin(spans))
        if spans[short] < shortest_s:
            shortest_s = float(spans[short])
            worst = Finding(
                value=max(need_s - shortest_s, 0.0),
                time_s=float(run.time_s[at[short + 1]]),
                note=f"{run.commands.outputs[column]} is the quickest, switched again after "
                f"{shortest_s * 1e3:.4g} ms; it needs {need_s * 1e3:.4g} ms",
            )
    return [worst]


_VALVE_KINDS = ("direction", "flow")


def valve_conflict(run: SwitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Time with opposite valves open together, or with one open without the soft-start valve, s."""
    machine = run.plan.machine
    on = {n: run.states[:, i] != 0 for i, n in enumerate(run.commands.outputs)}
    air = np.ones(len(run.time_s), dtype=bool)
    for name, output in machine.outputs.items():
        if output.kind == "soft-start":
            air &= on[name]
    # A sample holds until the next one.
    span = np.append(np.diff(run.time_s), 0.0)
    wrong = np.zeros(len(run.time_s), dtype=bool)
    for cylinder in machine.cylinders.values():
        forward, back = on[cylinder.forward.valve], on[cylinder.back.valve]
        wrong |= (forward & back) | ((forward | back) & ~air)
    at = np.flatnonzero(wrong)
    time_s = float(run.time_s[at[0]]) if len(at) else None
    return [Finding(value=float(span[wrong].sum()), time_s=time_s)]


def over_level(run: SwitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Amount by which the open flow controls of a cylinder exceed the unshaped level."""
    worst = Finding(value=0.0)
    on = {n: run.states[:, i] for i, n in enumerate(run.commands.outputs)}
    for axis, cylinder in run.plan.machine.cylinders.items():
        for side in (cylinder.forward, cylinder.back):
            flows = np.sum([flow.si * on[n] for n, flow in side.flows.items()], axis=0)
            level = np.where(on[side.valve] != 0, flows, 0.0)
            at = int(np.argmax(level))
            beyond = float(level[at]) - 1.0
            # Flow controls are set to a number of digits; their sum is 1 within this rounding.
            if beyond > max(side.level_tolerance, worst.value or 0.0):
                worst = Finding(value=beyond, time_s=float(run.time_s[at]), note=axis)
    return [worst]
