"""Messages between the panel and its clients, over a websocket, as JSON.

``docs/panel-protocol.json`` is their schema. Every message that changes a state carries the lease
of the client in control, and the number of the latest state that it has received; a stop carries
neither.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, create_model

from threadline.live.feed_override import LEAST_PERCENT, MOST_PERCENT
from threadline.panel.message_parts import (
    Board,
    Console,
    Criterion,
    Cylinder,
    Fill,
    Lane,
    Lines,
    NamedStep,
    Stitches,
    Tension,
    TurnRounds,
)
from threadline.proof.option_form import Door, Type
from threadline.proof.option_table import options_for

PANEL_PROTOCOL = 1
MOST_TEXT = 1 << 16
"""Longest message of a client, in bytes."""

MOST_STEP = 10.0
"""Longest step of an axis, in m or rad."""

Priority = Literal["programmed", "accuracy", "optimum", "speed"]
"""The operator's priority: the feed of the program or of the message; the operator's normal feed;
the fastest feed that keeps 20 % of every limit free; the fastest feed in spec."""
Text = Annotated[str, Field(max_length=200)]
Name = Annotated[str, Field(min_length=1, max_length=40)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


# --- commands, which only the client in control may give -----------------------------------------


class Simple(_Strict):
    """A command of one word.

    ``home`` finds the positions of the axes; ``zero`` moves every axis to 0, linear ones first;
    ``approach`` moves them to where the proven program begins; ``let-go`` ends a jog or a move;
    ``renew`` renews its lease; ``cancel`` ends a calculation; ``reconnect`` starts a new
    process and link. ``approach-rest`` moves the axes to where the rest of a run begins, and
    ``start-rest`` confirms and starts it.
    """

    what: Literal[
        "enable", "disable", "home", "zero", "approach", "renew", "let-go", "hold", "resume",
        "reset", "reconnect", "cancel", "approach-rest", "start-rest",
    ]  # fmt: skip


class ZeroAxis(_Strict):
    """Move one axis to 0."""

    what: Literal["zero-axis"]
    axis: Name


class Jog(_Strict):
    """Move an axis until a ``let-go`` comes, or until no ``renew`` came for the lease of a jog."""

    what: Literal["jog"]
    axis: Name
    share: Annotated[float, Field(ge=-1.0, le=1.0)]
    """Share of the manual feed; its sign is the direction."""


class Step(_Strict):
    """Move an axis by a distance, as long as the move is renewed."""

    what: Literal["step"]
    axis: Name
    by: Annotated[float, Field(ge=-MOST_STEP, le=MOST_STEP)]
    """Distance in m or rad; its sign is the direction."""


class ConsoleLine(_Strict):
    """Send a typed line to a controller at rest; a line that moves anything is refused."""

    what: Literal["console"]
    line: Annotated[str, Field(max_length=100)]


class OverrideFeed(_Strict):
    """Override the feed of the run: 10 to 100 % were proven."""

    what: Literal["override-feed"]
    percent: Annotated[int, Field(ge=LEAST_PERCENT, le=MOST_PERCENT)]


def _option_fields() -> dict[str, Any]:
    """Return the options of a calculation as the fields of a message, from their declarations."""
    fields: dict[str, Any] = {}
    for one in options_for("panel", Door.PANEL):
        kind: Any = Literal[one.choices] if one.choices else _TYPES[one.type]
        if kind is str:
            kind = Annotated[str, Field(max_length=one.most_text)]
        field = Field(one.default, description=one.help)
        fields[one.word] = (kind if one.default is not None else kind | None, field)
    return fields


_TYPES: Mapping[Type, type] = {Type.TEXT: str, Type.FLAG: bool, Type.RATIO: str}
if TYPE_CHECKING:
    _WithOptions = _Strict
else:
    _WithOptions = create_model("_WithOptions", __base__=_Strict, **_option_fields())


class Calculate(_WithOptions):
    """Plan, simulate and judge a program of the project folder.

    Options have the names, the texts and the defaults of ``threadline prove``.
    """

    what: Literal["calculate"]
    program: Text
    priority: Priority = "programmed"


class Start(_Strict):
    """Run the proven program, if it is still the same."""

    what: Literal["start"]
    proof: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    """Hash of the proof, as shown to the client."""
    override: Text | None = None


class Continue(_Strict):
    """Prepare the rest of an interrupted run; nothing moves before ``start-rest``.

    The latest calculation must have the same rows as that run.
    """

    what: Literal["continue"]
    run: Text
    at: Text = "block"
    """Where the work begins again: ``block``, ``circuit``, ``circuit 12``, ``line 40``,
    ``stitch 120``, ``back 10``."""
    proof: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    override: Text | None = None


Command = Annotated[
    Simple | ZeroAxis | Jog | Step | ConsoleLine | OverrideFeed | Calculate | Start | Continue,
    Field(discriminator="what"),
]


# --- messages of a client ------------------------------------------------------------------------


class Hello(_Strict):
    """First message of a client."""

    type: Literal["hello"]
    protocol: int
    name: Name
    token: Annotated[str, Field(max_length=200)] = ""


class Stop(_Strict):
    """Stop. Every client may send it, at any time, without a lease."""

    type: Literal["stop"]
    number: Annotated[int, Field(ge=1)] | None = None
    """Number of this stop: if an HTTP request has the same number, the stop is reported once."""


class Control(_Strict):
    """A request about control over the machine.

    ``take`` takes control if nobody has it, and asks for it if somebody has; ``give`` and ``keep``
    answer a client that asked; ``release`` gives it back.
    """

    type: Literal["control"]
    word: Literal["take", "give", "keep", "release"]


class Alive(_Strict):
    """A sign of life of the client in control; it renews the lease."""

    type: Literal["alive"]
    lease: Text


class Act(_Strict):
    """A command."""

    type: Literal["act"]
    lease: Text
    seen: int
    """Number of the latest state that the client has received."""
    number: Annotated[int, Field(ge=1)]
    """Number of this command; each is larger than the one before."""
    command: Command


ClientMessage = Annotated[Hello | Stop | Control | Alive | Act, Field(discriminator="type")]
CLIENT_MESSAGE: TypeAdapter[Hello | Stop | Control | Alive | Act] = TypeAdapter(ClientMessage)


# --- messages of the panel -----------------------------------------------------------------------


class Axis(BaseModel):
    """An axis of the machine, SI units."""

    name: str
    unit: Literal["m", "rad"]
    low: float | None
    high: float | None
    manual_feed: float


class Mandrel(BaseModel):
    """The mandrel, m: it turns with ``axis``, and has ``radius`` at the places ``at``."""

    axis: str
    along: str
    at: list[float]
    radius: list[float]


class Welcome(BaseModel):
    """Answer to a hello: the client's number, and the machine."""

    type: Literal["welcome"] = "welcome"
    protocol: int = PANEL_PROTOCOL
    client: int
    machine: str
    title: str
    link: str
    simulated: bool
    label: str = ""
    """What is at the far end of the link if it is neither a machine nor its twin."""
    lacks: dict[str, str] = {}
    """Commands that are not available on this link, and why."""
    notes: list[str] = []
    """Notes for the operator about the link."""
    untaught: str = ""
    """Why no part program can be taught to the machine; empty if one can."""
    by_hand: bool = True
    """Whether its axes can be moved by hand, one at a time."""
    feed_override: bool = True
    """Whether the machine has runs whose feed can be overridden."""
    options: list[str] = []
    """Options of planning and of the level that apply to the machine, as a command line names
    them."""
    normal_feed: bool = False
    """Whether the machine has an operator's normal feed, which the priority ``accuracy`` takes."""
    axes: list[Axis]
    cylinders: list[Cylinder] = []
    inputs: list[str] = []
    """Names of the machine's inputs, and of its outputs."""
    outputs: list[str] = []
    mandrel: Mandrel | None
    console: bool = False
    """Whether the link leads to a controller that takes typed lines at rest."""
    jog_lease_s: float
    control_lease_s: float


class Where(BaseModel):
    """Positions of an axis now, SI units; None if unknown, as for an axis that is not homed.

    ``load`` is the position of the driven mass, which only a simulated machine reports.
    """

    commanded: float | None
    measured: float | None
    load: float | None


class Holder(BaseModel):
    """Who controls the machine, and who asks for it."""

    client: int | None = None
    name: str = ""
    left_s: float = 0.0
    asks: int | None = None
    asks_name: str = ""
    passes_in_s: float = 0.0


class LiveContour(BaseModel):
    """The contour error of a run so far, m, at its samples; the judge looks between them, too."""

    now_m: float
    """The largest since the last state."""
    worst_m: float
    worst_s: float
    """Instant of the plan at which it is largest, s."""
    limit_m: float
    at: Literal["load", "encoder"]


class Reading(BaseModel):
    """A quantity besides the axes' own, such as the tension of the fibre; SI units."""

    value: float
    unit: str


class Progress(BaseModel):
    """Progress of the present run, or the final progress of the last run."""

    run: str
    program: str
    """Name of the job; the file of a winding or a cycle states its own name."""
    file: str
    """Name of the job's file, as in the request ``calculate``."""
    time_s: float
    duration_s: float
    ended: str | None = None
    why: str = ""
    verdict: str = ""
    completed: int = 0
    """Completed runs of this program since the machine was connected."""
    hold: Literal["at once", "at a rest", "at the end"] = "at once"
    """Where a hold takes effect: on the path, at the next rest of the program, or at its end."""
    hold_at_s: float | None = None
    """Instant of the plan, s, of the rest at which a hold takes effect; None without a rest."""
    contour: LiveContour | None = None
    """Contour error of the run; None if the link measures no positions."""


class RestOfRun(BaseModel):
    """The rest of an interrupted run, ready to start; a stop drops it."""

    run: str
    notes: list[str]
    """The moves to come, and where the work begins again."""


class Proven(BaseModel):
    """The latest calculation."""

    program: str
    proof: str
    passed: bool
    closing: str


class State(BaseModel):
    """All data that a client needs in order to act; sent 20 times a second, or 10 if unchanged."""

    type: Literal["state"] = "state"
    seq: int
    state: str
    why: str
    allowed: list[str]
    """Commands that are possible now."""
    age_s: float
    """Age of the positions when this was sent, s."""
    time_s: float
    """Machine time since the start of this motion, s."""
    axes: dict[str, Where]
    signals: dict[str, float]
    """State of each digital input and output."""
    readings: dict[str, Reading] = {}
    """Reported quantities that belong to no axis."""
    late_ticks: int
    feed_percent: int = 100
    """Override of the feed of the run, %."""
    no_override: str = ""
    """Reason why the feed of the run cannot be overridden; empty if it can."""
    control: Holder
    progress: Progress | None
    rest: RestOfRun | None = None
    proven: Proven | None
    calculating: float | None
    """Share done of a calculation; None without one."""
    board: Fill | None = None
    """How full the controller is; None if it does not report it."""
    busy: str = ""
    """Why no run and no calculation can begin now, for people; empty if they can."""
    clients: int


class Leased(BaseModel):
    """The client is in control, with this lease."""

    type: Literal["leased"] = "leased"
    lease: str


class Answer(BaseModel):
    """Answer to a command: done, or why not."""

    type: Literal["answer"] = "answer"
    number: int
    ok: bool
    text: str = ""


class Figures(BaseModel):
    """The result of a calculation, SI units."""

    type: Literal["figures"] = "figures"
    program: str
    proof: str
    passed: bool
    closing: str
    duration_s: float
    feed: str | None
    """Feed of the plan, if it is not the program's."""
    ticks: int | None
    circuits: int | None
    ticks_per_circuit: int | None
    points: int
    warnings: list[str]
    doubts: list[str] = []
    """What is doubtful about the model of the machine."""
    criteria: list[Criterion]
    times_s: list[float]
    planned: dict[str, list[float]]
    """Planned positions of each axis at ``times_s``."""
    mandrel: Mandrel | None
    """The plan's mandrel."""
    lines: Lines
    stitches: Stitches | None
    steps: list[NamedStep]
    lanes: list[Lane]
    turn_rounds: TurnRounds | None = None
    tension: Tension | None = None


class Preview(BaseModel):
    """A program before it is calculated, SI units; the answer to a request."""

    program: str
    planned: dict[str, list[float]]
    """Programmed positions of each axis, thinned if there are many."""
    line: list[int]
    """The line of each position."""
    moves: int
    whole: bool
    """Whether the positions reach to the end of the program."""
    paced_by: str
    stitches: Stitches | None
    steps: list[NamedStep]
    warnings: list[str]
    mandrel: Mandrel | None
    file: str
    """The file that holds the lines: for a seam its drawing or table, otherwise the job."""
    text: list[str]
    """Its text; empty for a binary or a very long file."""


class Said(BaseModel):
    """An event, for people."""

    type: Literal["said"] = "said"
    text: str
    wrong: bool = False


ServerMessage = Annotated[
    Welcome | State | Leased | Answer | Figures | Said | Board | Console,
    Field(discriminator="type"),
]


def schema() -> dict[str, Any]:
    """Return the JSON schema of both directions."""
    server: TypeAdapter[Any] = TypeAdapter(ServerMessage)
    return {
        "title": "Threadline operator panel",
        "protocol": PANEL_PROTOCOL,
        "from_client": CLIENT_MESSAGE.json_schema(),
        "from_panel": server.json_schema(mode="serialization"),
    }
