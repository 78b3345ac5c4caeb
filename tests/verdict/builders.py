"""Plans and recordings made by hand, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction

import numpy as np

from tests.made import Made
from threadline.base.arrays import FloatArray
from threadline.commands.plan import Motion, Plan
from threadline.files import (
    Channel,
    ChannelKind,
    Clock,
    Recording,
    RecordingBlock,
    Stream,
    TickBlock,
    TickTable,
)
from threadline.jobs.operations import Feed, FeedMode, Job, Move, Source
from threadline.machine import Machine, load_machine
from threadline.motion.path.types import (
    PieceBlock,
    PlannedPath,
    ProgrammedPath,
    Timing,
    VertexBlock,
)
from threadline.motion.timing.types import Trajectory, TrajectoryBlock
from threadline.verdict import Criterion, Spec

TICK_S = 0.005
SERVO = Clock("servo", Fraction(5, 1000))
UNIT = {ChannelKind.VOLTAGE: "V", ChannelKind.CURRENT: "A"}


def winder() -> Machine:
    """Return the machine of the plans."""
    return load_machine("lathe-winder")


def plan_through(
    points: Sequence[Sequence[float]],
    axes: tuple[str, ...] = ("X", "Y"),
    *,
    move_s: float = 0.1,
    vertices_per_block: int = 1000,
    historical: bool = False,
    pieces: Callable[[FloatArray], FloatArray] | None = None,
) -> Plan:
    """Return a plan that visits ``points`` in straight lines, ``move_s`` each.

    Vertex i belongs to operation i - 1 (the first move is operation 0) and to line 10 i. ``pieces``
    turns (n, 2, axes) coefficients of the chords into other coefficients.
    """
    machine = winder()
    vertices = np.asarray(points, dtype=float).reshape(-1, len(axes))
    moves = len(vertices) - 1
    operation = np.maximum(np.arange(moves + 1) - 1, 0)
    line = 10 * np.arange(moves + 1)
    column = [machine.axis_names.index(axis) for axis in axes]
    radius = machine.radius_m[column]

    def vertex_blocks():
        for begin in range(0, moves + 1, vertices_per_block):
            part = slice(begin, min(begin + vertices_per_block, moves + 1))
            count = part.stop - part.start
            rest = np.zeros(count, dtype=np.int64)
            yield VertexBlock(
                positions=vertices[part],
                operation=operation[part],
                nominal_s=np.where(np.arange(part.start, part.stop) > 0, move_s, 0.0),
                rest=rest,
                dwell_s=np.zeros(count),
                line=line[part],
            )

    chords = np.stack([vertices[:-1], np.diff(vertices, axis=0)], axis=1)
    coefficients = chords if pieces is None else pieces(chords)
    planned = PlannedPath(
        axes=axes,
        radius_m=radius,
        interpolation="by hand",
        timing=Timing.TIME,
        historical=historical,
        blocks=Stream.of(
            [
                PieceBlock(
                    coefficients=coefficients,
                    operation=np.arange(moves),
                    nominal_s=np.full(moves, move_s),
                    rest_after=np.zeros(moves, dtype=np.int64),
                    dwell_s=np.zeros(moves),
                    line=line[1:],
                )
            ]
        ),
    )
    trajectory = Trajectory(
        axes=axes,
        historical=historical,
        blocks=Stream.of(
            [
                TrajectoryBlock(
                    start_s=move_s * np.arange(moves),
                    duration_s=np.full(moves, move_s),
                    coefficients=coefficients,
                    operation=np.arange(moves),
                )
            ]
        ),
    )
    rows = round(moves * move_s / TICK_S)
    commands = TickTable(
        clock=SERVO,
        axes=axes,
        counts_per_unit=machine.counts_per_unit[column],
        start_counts=np.zeros(len(axes), dtype=np.int64),
        blocks=Stream.of(
            [
                TickBlock(
                    first_tick=0,
                    counts=np.zeros((rows, len(axes)), dtype=np.int64),
                    operation=np.arange(rows) // max(round(move_s / TICK_S), 1),
                )
            ]
        ),
        job_sha256="job",
        machine_sha256=machine.sha256,
    )
    feed = Feed(FeedMode.FASTEST_AXIS, 0.1)
    return Plan(
        job=Job(
            name="by hand",
            file="by-hand.prg",
            sha256="job",
            axes=axes,
            start=tuple(vertices[0].tolist()),
            operations=Stream.of(
                Move(tuple(p.tolist()), feed, Source("by-hand.prg", 10 * i))
                for i, p in enumerate(vertices[1:], start=1)
            ),
        ),
        machine=machine,
        commands=commands,
        intent=Motion(
            programmed=ProgrammedPath(axes=axes, radius_m=radius, blocks=Made(vertex_blocks)),
            path=planned,
            trajectory=trajectory,
        ),
        options={"interpolation": "by hand"},
    )


def record(
    axes: tuple[str, ...],
    channels: Mapping[ChannelKind, FloatArray],
    operation: FloatArray | None,
    *,
    per_block: int = 64,
    clock: Clock = SERVO,
    stride: int = 1,
    job_sha256: str = "job",
    simulated: bool = True,
) -> Recording:
    """Return a recording of (n, axes) arrays per kind; NaN columns are absent."""
    described: list[Channel] = []
    columns: dict[str, FloatArray] = {}
    for kind, values in channels.items():
        for column, axis in enumerate(axes):
            if np.isnan(values[:, column]).all():
                continue
            name = f"{axis}.{kind}"
            unit = UNIT.get(kind, "rad" if axis == "A" else "m")
            unit += "/s" if kind is ChannelKind.VELOCITY else ""
            described.append(
                Channel(name=name, kind=kind, unit=unit, clock=clock, axis=axis, stride=stride)
            )
            columns[name] = np.asarray(values[:, column], dtype=float)
    if operation is not None:
        described.append(
            Channel(
                name="operation", kind=ChannelKind.OPERATION, unit="", clock=clock, stride=stride
            )
        )
        columns["operation"] = np.asarray(operation, dtype=float)
    count = len(next(iter(columns.values())))
    blocks = [
        RecordingBlock(
            first_tick={clock.name: begin * stride},
            samples={name: values[begin : begin + per_block] for name, values in columns.items()},
        )
        for begin in range(0, count, per_block)
    ]
    return Recording(
        channels=tuple(described),
        blocks=Stream.of(blocks),
        job_sha256=job_sha256,
        machine_sha256="",
        simulated=simulated,
    )


def follow(
    points: Sequence[Sequence[float]], per_move: int, standstill: int = 40
) -> tuple[FloatArray, FloatArray]:
    """Return commanded (n, axes) positions along chords and (n,) operations, then a standstill.

    Sample k is the position before row k of the table acts: the last vertex is reached once the
    rows of its operation are used up.
    """
    vertices = np.asarray(points, dtype=float)
    moves = len(vertices) - 1
    along = np.minimum(np.arange(moves * per_move + 1 + standstill) / per_move, moves)
    operation = np.minimum(np.floor(along), moves - 1)
    part = (along - operation)[:, None]
    at = operation.astype(int)
    return vertices[at] * (1 - part) + vertices[at + 1] * part, operation


def move_s(operation: FloatArray) -> float:
    """Return the duration of each move of ``follow``, as in a plan with the same times."""
    return TICK_S * float(np.count_nonzero(operation == operation[0]))


def spec_of(*criteria: Criterion, lag_s: float = 0.1) -> Spec:
    """Return a specification made by hand."""
    return Spec(name="by hand", criteria=criteria, lag_s=lag_s)
