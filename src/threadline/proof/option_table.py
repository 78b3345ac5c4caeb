"""Every option of planning, judging and searching, declared once.

The command line, ``import threadline as tl``, the panel's messages and its page, recordings,
proofs and the reference page (``docs/options.md``) are made from ``TABLE``. A new option is one
entry; an option that changes how a job is planned also names the attribute of ``Options`` that
the planner reads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from threadline.base.option_defaults import (
    AUTO,
    DEFAULT_CONTOUR_M,
    DEFAULT_INTERPOLATION,
    DEFAULT_LIMITS,
    DEFAULT_TOLERANCE,
    FEED_FORWARD,
    MOST_REPEATS,
    NO_CONTOUR,
    OPTIMAL_FEED_FORWARD,
)
from threadline.commands.learned import MOST_TEXT as MOST_TABLE_TEXT
from threadline.commands.learned import table_text
from threadline.machine.motion_planner import DIALECT_NAMES, FEED_RULES
from threadline.machine.radii import written_out
from threadline.motion.path.interpolations import INTERPOLATIONS
from threadline.proof.option_form import STEPS, SWITCHES, TICKS, Door, FileForm, Group, Option, Type
from threadline.proof.option_words import (
    LONG_STITCHES,
    feed_words,
    narrow_words,
    parse_contour_m,
    parse_damping,
    parse_feed,
    parse_long_stitches,
    parse_narrow,
    parse_outside_m,
    parse_reserve,
    parse_robust,
    parse_shaper_text,
    parse_share,
    parse_tolerance_m,
    parse_width_s,
    recorded_share,
    reserve_words,
)
from threadline.winding.product import product_text

PLANNERS = (
    "prove", "run", "compile", "equal", "compare", "fastest", "yield", "design", "animate", "judge",
    "learn", "panel",
)  # fmt: skip
"""The verbs that plan a job; ``panel`` stands for a calculation on the panel."""
_TYPED = tuple(verb for verb in PLANNERS if verb != "panel")
PYTHON_VERBS = (
    "prove", "run", "fastest", "compare", "yield", "design", "judge", "compile", "equal", "learn",
)  # fmt: skip
"""The verbs of ``import threadline as tl``."""
_PYTHON_NAMES = {"yield": "yields"}
_OF_LISTS = "compare"  # its Python function takes several values as a list, named in the plural
PROGRAMMED = "programmed"
"""Text that a recording has as its feed if the plan keeps the feeds of the job."""
MOST_PROFILE = 20_000
"""Longest text of the radii of a mandrel, in characters."""


def _same(value: Any) -> str | None:
    return None if value is None else str(value)


def _exact(unit: str) -> Callable[[Any], str | None]:
    """Return a function that writes a number with its unit, exact to the last bit."""
    return lambda value: None if value is None else f"{value!r} {unit}"


def _laws() -> tuple[str, ...]:
    from threadline.motion.laws.catalogue import LAWS  # few proofs use a law

    return tuple(LAWS)


_SHAPED = tuple(verb for verb in PLANNERS if verb not in {"fastest", "learn"})
_PROVING = ("prove", "run", "compare", "fastest", "design")
_OF_VERDICT = (*_PROVING, "learn", "panel")
_AS_GIVEN = "As with prove; default: the recording's."
_EACH = (
    "Names, separated by commas; default: linear,b-spline,b-spline-pulled, and firmware,auto "
    "if the machine file names a motion planner."
)

TABLE: tuple[Option, ...] = (
    Option(
        name="spec", short="s", group=Group.INPUT, type=Type.SPEC,
        help="Specification file (.toml); default: the machine's own.",
        verbs=tuple(verb for verb in _TYPED if verb not in ("compile", "equal")),
        doors=(Door.LINE, Door.PYTHON),
    ),
    Option(
        name="par", group=Group.INPUT, type=Type.FILE,
        help="FW-CNC.PAR whose settings replace the settings of the machine file.",
        helps={"judge": "FW-CNC.PAR; default: the file that the recording names."},
        verbs=_TYPED,
        doors=(Door.LINE, Door.PYTHON),
    ),
    Option(
        name="actual", group=Group.INPUT, type=Type.MACHINE,
        help="Machine that runs the plan made for --machine: a file or a library name.",
        helps={
            "run": "With --link sim: the simulated machine, planned for --machine: a file or a "
            "library name. The proof is for --machine.",
            "judge": "The machine that ran the plan; default: the recording's.",
            "learn": "Machine that repeats the job, planned for --machine: a file or a library "
            "name. Default: the same machine.",
        },
        verbs=("prove", "run", "compare", "fastest", "yield", "animate", "judge", "learn"),
        doors=(Door.LINE, Door.PYTHON),
    ),
    Option(
        name="interpolation", many=("compare",), group=Group.PLAN, verbs=PLANNERS, kinds=(TICKS,),
        values=lambda: INTERPOLATIONS,
        help="auto, optimal, firmware, point-to-point, linear, parabolic, cubic, quintic, "
        "b-spline, b-spline-pulled, law:NAME. Default: firmware if the machine file names a motion "
        "planner, else auto; compile, which writes another program, has auto.",
        helps={"compare": _EACH, "judge": _AS_GIVEN},
        default=DEFAULT_INTERPOLATION, defaults={"compile": AUTO, "equal": AUTO},
        attribute="interpolation", parse=str,
        recorded=FileForm(key="interpolation", write=_same, read=str, required=True),
        label="Interpolation",
    ),
    Option(
        name="law", group=Group.PLAN, kinds=(TICKS, STEPS),
        verbs=tuple(verb for verb in PLANNERS if verb != "compare"),
        values=_laws,
        help="Make every move from rest to rest follow this motion law: modified-sine, harmonic:7, "
        "frame.csv (threadline law lists them).",
        label="Law", placeholder="default",
    ),
    Option(
        name="feed", many=("compare",), group=Group.PLAN, unit="m/s", kinds=(TICKS, STEPS),
        verbs=tuple(verb for verb in PLANNERS if verb != "fastest"),
        help='Replaces every programmed feed: "10 count/tick", "36 mm/s" '
        '(of the fastest axis), "F 3000" (mm/min, by the program\'s rule for F). "120 %" '
        "multiplies each, so that they keep their ratios.",
        helps={
            "compare": "Feeds, separated by commas; default: as programmed.", "judge": _AS_GIVEN,
        },
        attribute="feed", parse=parse_feed,
        recorded=FileForm(
            key="feed", required=True,
            write=lambda feed: PROGRAMMED if feed is None else feed_words(feed),
            read=lambda text: None if text == PROGRAMMED else parse_feed(text),
        ),
        label="Feed", placeholder="as programmed",
    ),
    Option(
        name="dialect", group=Group.PLAN, verbs=PLANNERS, kinds=(TICKS,),
        values=lambda: DIALECT_NAMES,
        help=f"Dialect of a part program: {', '.join(DIALECT_NAMES)}. Default: the machine file's.",
        attribute="dialect", parse=str,
        recorded=FileForm(key="dialect", write=_same, read=str),
        label="Dialect", placeholder="the machine's",
    ),
    Option(
        name="feed-mode", group=Group.PLAN, verbs=PLANNERS, kinds=(TICKS,),
        values=lambda: tuple(name for name in FEED_RULES if name != "base-axes"),  # needs axes
        help="Rule by which F of a part program is a speed: cadfil, fanuc, fluidnc, grbl, "
        "linuxcnc, marlin, rs274, fastest-axis, path, or base-axes:A and base-axes:A,X, CADFIL's "
        "modes 1 and 2. Default: the machine file's.",
        attribute="feed_mode", parse=str,
        recorded=FileForm(key="feed-mode", write=_same, read=str),
        label="Rule of F", placeholder="the machine's",
    ),
    Option(
        name="axes", group=Group.PLAN, kinds=(TICKS,),
        verbs=PLANNERS,
        help="Axes of the machine that move for the axes of a program made for another machine: "
        '"C=A,Z=X" moves A for C, and X for Z. B=none ignores the words of B, E=none the filament '
        "of a 3D print, and macros=none the moves of Klipper's macros.",
        attribute="axes", parse=str,
        recorded=FileForm(key="axes", write=_same, read=str),
    ),
    Option(
        name="radius", group=Group.PLAN, unit="m", verbs=PLANNERS, kinds=(TICKS,),
        help='Radius at which a rotary axis acts: "A=40 mm" for a mandrel of 80 mm diameter, '
        '"A=20 mm at X 0 mm; 50 mm at X 100 mm" for a cone, or "A=mandrel.csv". Default: the '
        "machine file's.",
        attribute="radius", parse=written_out, most_text=MOST_PROFILE,
        recorded=FileForm(key="radius", write=_same, read=str),
        label="Radius", placeholder="the machine's",
    ),
    Option(
        name="product", group=Group.PLAN, kinds=(TICKS,),
        verbs=tuple(verb for verb in PLANNERS if verb not in {"compile", "equal"}),
        help="Product of a winder (NAME.wind.toml, or a file of FiberPath or CADFIL), to judge "
        "the place of its fibre, too.",
        helps={"judge": "Product of a winder (NAME.wind.toml); default: the recording's."},
        attribute="product", parse=product_text,
        recorded=FileForm(key="product", write=_same, read=product_text),
        label="Product", placeholder="none",
    ),
    Option(
        name="offset", group=Group.PLAN, unit="m or rad", verbs=PLANNERS, kinds=(TICKS,),
        help='Machine position of the zero of a part program: "X=12 mm, A=30 deg". Default: '
        "the machine's zero.",
        attribute="offset", parse=str,
        recorded=FileForm(key="offset", write=_same, read=str),
        label="Mandrel offset", placeholder="none",
    ),
    Option(
        name="needle", group=Group.PLAN, unit="stitch/s", kinds=(TICKS,),
        verbs=tuple(verb for verb in PLANNERS if verb != "fastest"),
        help='Replaces the needle speed of a seam: "75 stitch/s".',
        attribute="needle", parse=str,
        recorded=FileForm(key="needle", write=_same, read=str),
    ),
    Option(
        name="long-stitches", group=Group.PLAN, kinds=(STEPS,),
        verbs=PLANNERS,
        values=lambda: LONG_STITCHES,
        help="How stitches of a design that are longer than the machine's longest move are sewn: "
        "travel (needle up; the default), split (the needle enters on the way) or refuse. Jumps "
        "before such a stitch change nothing.",
        helps={"judge": _AS_GIVEN},
        attribute="long_stitches", parse=parse_long_stitches,
        recorded=FileForm(key="long-stitches", write=_same, read=parse_long_stitches),
        label="Long stitches", placeholder="travel",
    ),
    Option(
        name="tolerance", group=Group.PLAN, unit="m", verbs=PLANNERS, kinds=(TICKS, STEPS),
        help="Largest deviation from the programmed path, kept by auto, optimal and parabolic: "
        '"0.1 mm".',
        helps={"fastest": "Largest deviation from the programmed path; default: searched with "
               f"optimal, else {DEFAULT_TOLERANCE}."},
        default=DEFAULT_TOLERANCE, defaults={"fastest": None},
        attribute="tolerance_m", parse=parse_tolerance_m,
        recorded=FileForm(
            key="tolerance", write=_exact("m"), read=parse_tolerance_m, required=True
        ),
        label="Tolerance", placeholder=DEFAULT_TOLERANCE,
    ),
    Option(
        name="limits", group=Group.PLAN, kinds=(TICKS,),
        verbs=tuple(verb for verb in PLANNERS if verb != "fastest"),
        help="Share of the acceleration and jerk limits that the planner uses.",
        default=DEFAULT_LIMITS, attribute="limit_share", parse=parse_share,
        recorded=FileForm(key="limits", write=recorded_share, read=parse_share),
    ),
    Option(
        name="shaper", many=("compare",), group=Group.PLAN, verbs=PLANNERS, kinds=(TICKS, SWITCHES),
        help='Shape the motion: "zv:12Hz:0.02" is kind, frequency, damping ratio; "*" convolves, '
        '"X=..., Y=..." gives each axis its own; on an on/off machine zv, um-2ei, zv*um-2ei ... '
        "or none.",
        helps={
            "compare": "Shapers, separated by commas, each as for prove; on an on/off machine the "
            "default is none,zv,um-zv,um-zvd.",
            "judge": _AS_GIVEN,
        },
        attribute="shaper", parse=parse_shaper_text,
        recorded=FileForm(key="shaper", write=_same, read=parse_shaper_text),
        label="Shaper", placeholder="none",
    ),
    Option(
        name="mode", group=Group.PLAN, unit="Hz", kinds=(SWITCHES,),
        verbs=_SHAPED,
        help='On an on/off machine: design mode of its shaper, "3.04 Hz"; default: the machine\'s.',
        attribute="shaper_mode", parse=str,
        recorded=FileForm(key="mode", write=_same, read=str),
        label="Mode", placeholder="the machine's",
    ),
    Option(
        name="damping", group=Group.PLAN, type=Type.RATIO, kinds=(SWITCHES,),
        verbs=_SHAPED,
        help="Damping ratio of the --mode of an on/off machine; default: the machine's.",
        attribute="shaper_damping", parse=parse_damping,
        recorded=FileForm(
            key="damping", read=parse_damping,
            write=lambda ratio: None if ratio is None else repr(ratio),
        ),
        label="Damping", placeholder="the machine's",
    ),
    Option(
        name="feed-forward", group=Group.PLAN, type=Type.FLAG, verbs=PLANNERS, kinds=(TICKS,),
        help="Feed-forward by the inverses of the axes' models, so that the loads follow the path.",
        helps={"judge": "The plan has feed-forward; default: the recording's."},
        default=False, attribute="feed_forward_s",
        recorded=FileForm(key="feed-forward", write=_exact("s"), read=parse_width_s),
        label="Loads follow",
    ),
    Option(
        name="smoothing", many=("design",), group=Group.PLAN, unit="s",
        verbs=PLANNERS, kinds=(TICKS,),
        help=f'Time over which feed-forward smooths the motion; default "{FEED_FORWARD}", with '
        f'optimal "{OPTIMAL_FEED_FORWARD}".',
        helps={
            "design": f'Smoothing times of feed-forward to try: "36 ms, 50 ms"; default '
            f"{FEED_FORWARD}.",
            "judge": f"Smoothing time of feed-forward; default: the recording's, else "
            f'"{FEED_FORWARD}".',
        },
        attribute="change_s",
        recorded=FileForm(key="change", write=_exact("s"), read=parse_width_s),
        label="Smoothing", placeholder="default",
    ),
    Option(
        name="robust", group=Group.PLAN, kinds=(TICKS, STEPS),
        verbs=PLANNERS,
        help="With --feed-forward: keep the loads from ringing for all masses and stiffnesses "
        'within this share of their tolerances: "100 %". --smoothing is then the time in which '
        "the speed may change, by default four turns of a seam's needle. On an embroidery frame: "
        "every needle enters within the tolerance for all of them; by default for 5 % of the "
        "tolerances, the usual accuracy of a measured mode.",
        helps={
            "fastest": "One plan for all machines with loads and springs at the ends of this share "
            'of their tolerances, each judged in one run: "100 %". The answer also gives the '
            "loss of speed. With --feed-forward the plan is made for all of them.",
            "judge": _AS_GIVEN,
        },
        attribute="robust_share", parse=parse_robust,
        recorded=FileForm(key="robust", write=recorded_share, read=parse_robust),
        label="Robust", placeholder="default",
    ),
    Option(
        name="contour", group=Group.PLAN, unit="m", verbs=PLANNERS, kinds=(TICKS,),
        help=f"With optimal: largest deviation of the loops from the path; default "
        f'"{DEFAULT_CONTOUR_M * 1e3:g} mm", "{NO_CONTOUR}" for no limit. With --feed-forward: '
        "largest deviation of the loads from their motion at the start and end of the table.",
        attribute="contour_m", parse=parse_contour_m,
        recorded=FileForm(
            key="contour", read=parse_contour_m,
            write=lambda width: NO_CONTOUR if width == float("inf") else _exact("m")(width),
        ),
        label="Contour", placeholder=f"{DEFAULT_CONTOUR_M * 1e3:g} mm, with optimal",
    ),
    Option(
        name="outside", group=Group.PLAN, unit="m", verbs=PLANNERS, kinds=(TICKS,),
        help="With optimal: how far the path may leave the program on the outside of its corners, "
        'at most the tolerance: "0.1 mm". A path that enters and leaves a corner on its outside '
        "rounds it more widely. Default: the path stays on the inside.",
        helps={"fastest": "With optimal: how far the path may leave the program on the outside of "
               "its corners; default: searched."},
        attribute="outside_m", parse=parse_outside_m,
        recorded=FileForm(
            key="outside", write=lambda m: _exact("m")(m or None), read=parse_outside_m
        ),
        label="Outside", placeholder="none, with optimal",
    ),
    Option(
        name="reserve", group=Group.PLAN, verbs=PLANNERS, kinds=(TICKS,),
        help="With optimal: share of volts and current of every drive that the plan leaves to the "
        'loop: "5 %", "volts 1 %, current 3 %". Default: the reserve in the machine file, else '
        "10 %.",
        helps={"fastest": "With optimal: share of volts and current of every drive that the plan "
               "leaves to the loop; default: searched."},
        attribute="reserve", parse=parse_reserve,
        recorded=FileForm(
            key="reserve", read=parse_reserve,
            write=lambda kept: None if kept is None else reserve_words(kept),
        ),
        label="Reserve", placeholder="the machine's, with optimal",
    ),
    Option(
        name="narrow", group=Group.PLAN, unit="m", verbs=PLANNERS, kinds=(TICKS,),
        help="With optimal: smaller tolerances for some corners, by the program line of the move "
        'that ends there: "13: 0.38 mm, 22: 0.4 mm".',
        helps={"fastest": "With optimal: smaller tolerances for some corners, by the program line "
               "of the move that ends there; default: searched."},
        attribute="narrow", parse=parse_narrow, most_text=MOST_PROFILE,
        recorded=FileForm(key="narrow", write=narrow_words, read=parse_narrow),
        label="Narrow", placeholder="none, with optimal",
    ),
    Option(
        name="table", group=Group.PLAN, kinds=(TICKS,),
        verbs=("prove", "run", "compile", "equal", "yield", "animate", "judge", "learn"),
        help="Play this table, which threadline learn has written, in place of the planned one. It "
        "is valid only for the job, machine file and planning options with which it was learned.",
        helps={
            "judge": "The learned table that was played; default: the recording's.",
            "learn": "Begin with this learned table instead of the plan's.",
        },
        attribute="table", parse=table_text, most_text=MOST_TABLE_TEXT,
        doors=(Door.LINE, Door.PYTHON),
        recorded=FileForm(key="table", write=_same, read=table_text),
    ),
    Option(
        name="level", group=Group.LEVEL, verbs=_OF_VERDICT,
        help="How far the verdict reaches: nominal is one run; repeated is 20 runs with other "
        "encoder phases, friction and supply; over tolerances adds other machines within the "
        "tolerances of the machine file.",
        default="repeated", choices=("nominal", "repeated", "over tolerances"),
        doors=(Door.PYTHON, Door.PANEL),
    ),
    Option(
        name="nominal", group=Group.LEVEL, type=Type.FLAG, verbs=(*_PROVING, "learn"),
        default=False,
        help="Judge one run of the machine as its file says; the next run may differ.",
        doors=(Door.LINE,),
    ),
    Option(
        name="repeats", group=Group.LEVEL, type=Type.COUNT, verbs=_PROVING,
        least=1, most=MOST_REPEATS,
        help="How many runs, each with other encoder phases, friction and supply; default 20.",
        doors=(Door.LINE, Door.PYTHON),
    ),
    Option(
        name="tolerances", group=Group.LEVEL, type=Type.FLAG, verbs=(*_PROVING, "learn"),
        default=False,
        help="Also judge the worst machine within the tolerances of the machine file that a search "
        "finds, and 200 drawn machines.",
        doors=(Door.LINE,),
    ),
    Option(
        name="yield", group=Group.LEVEL, verbs=_OF_VERDICT,
        help='Share of the machines within the tolerances that must be in spec: "99 %", judged '
        "by the lower end of the exact 95 % interval of 1000 drawn machines.",
    ),
    Option(
        name="ends", group=Group.LEVEL, verbs=_OF_VERDICT,
        help="Also judge the machines with loads and springs at the ends of this share of their "
        'tolerances, one run each: "100 %".',
        helps={
            "learn": "Learn on each machine with loads and springs at the ends of this share of "
            'their tolerances, every machine its own table: "100 %".',
            "fastest": "Every plan must also pass on the machines with loads and springs at the "
            'ends of this share of their tolerances, one run each: "100 %"; --robust plans for '
            "them.",
        },
        label="Ends of tolerances", placeholder="none",
    ),
    Option(
        name="band", group=Group.LEVEL, verbs=_OF_VERDICT,
        help="Also judge machines whose modes vary by this share of their frequencies, one "
        'run each: "20 %".',
        helps={
            "learn": "Learn on each of several machines whose modes vary by this share of their "
            'frequencies, every machine its own table: "20 %".',
            "fastest": "Every plan must also pass on machines whose modes vary by this share "
            'of their frequencies: "20 %". An on/off machine gets commands made for that band.',
        },
        label="Band of modes", placeholder="none",
    ),
    Option(
        name="margin", group=Group.SEARCH, verbs=("fastest",), default="0 %",
        help='Share of every limit of the specification to keep free: "20 %"; the machine\'s '
        "own limits stay.",
        doors=(Door.LINE, Door.PYTHON),
    ),
    Option(
        name="low", group=Group.SEARCH, unit="m/s", verbs=("fastest",),
        help='Lowest feed to try; of a seam "5 stitch/s".', doors=(Door.LINE, Door.PYTHON),
    ),
    Option(
        name="high", group=Group.SEARCH, unit="m/s", verbs=("fastest",),
        help="Highest feed to try.", doors=(Door.LINE, Door.PYTHON),
    ),
    Option(
        name="learned", group=Group.SEARCH, type=Type.COUNT, verbs=("fastest",), least=1, most=100,
        help="Number of repeats after which every plan is judged, with the table learned by then "
        "(threadline learn). With --ends every machine learns its own table.",
        doors=(Door.LINE, Door.PYTHON),
    ),
    Option(
        name="mismatch", group=Group.SEARCH, type=Type.FLAG, verbs=("fastest",), default=False,
        help="Search again on machines with masses and stiffnesses at the ends of their "
        "tolerances, with plans for the machine of the file.",
        doors=(Door.LINE, Door.PYTHON),
    ),
    Option(
        name="within", group=Group.SEARCH, unit="s", verbs=("fastest",),
        help='Longest time of the search, "5 min"; then the best result so far is printed. '
        "Without it a search over the choices of optimal ends after 10 min of processor time. "
        "Ctrl-C ends the search at once.",
        doors=(Door.LINE, Door.PYTHON),
    ),
    Option(
        name="cluster", group=Group.WHERE,
        verbs=("prove", "compare", "fastest", "yield", "design", "learn"),
        help="With --tolerances: judge the machines within the tolerances on "
        'the workers of this scheduler of distributed: "localhost:8786"; another computer only '
        'by TLS, "tls://HOST:8786". The answer is the same to the bit.',
        helps=dict.fromkeys(
            ("yield", "design"),
            "Judge the machines on the workers of this scheduler of distributed: "
            '"localhost:8786"; another computer only by TLS, "tls://HOST:8786". The answer is the '
            "same to the bit.",
        ),
        doors=(Door.LINE, Door.PYTHON),
    ),
)  # fmt: skip
"""The options, in the order in which help, reference and recordings name them."""


def option(name: str) -> Option:
    """Return the option with a name.

    Raises
    ------
    KeyError
        If there is none.
    """
    return _BY_NAME[name]


def python_name(verb: str) -> str:
    """Return the name of the Python function for a verb: ``yield`` is a keyword of Python.

    >>> python_name("yield"), python_name("prove")
    ('yields', 'prove')
    """
    return _PYTHON_NAMES.get(verb, verb)


def list_argument(one: Option, verb: str) -> str | None:
    """Return the argument for several values of an option in a verb's Python function, or None.

    >>> list_argument(option("feed"), "compare"), list_argument(option("feed"), "prove")
    ('feeds', None)
    """
    return f"{one.word}s" if verb == _OF_LISTS and verb in one.many else None


def verb_of(name: str) -> str:
    """Return the verb that a Python function of ``import threadline as tl`` belongs to.

    >>> verb_of("yields"), verb_of("prove")
    ('yield', 'prove')
    """
    return next((verb for verb, own in _PYTHON_NAMES.items() if own == name), name)


_BY_NAME = {one.name: one for one in TABLE}
RECORDED = tuple((one, one.recorded) for one in TABLE if one.recorded is not None)
"""The planning options that recordings and proofs write, each with its form in the file."""


def options_for(
    verb: str, door: Door = Door.LINE, groups: Iterable[Group] = tuple(Group)
) -> tuple[Option, ...]:
    """Return the options of a verb at one interface."""
    among = tuple(groups)
    listed = verb if door is Door.PYTHON and verb == _OF_LISTS else ""
    return tuple(
        one
        for one in TABLE
        if verb in one.verbs and door in one.doors and one.group in among and listed not in one.many
    )


def planned_by(kind: str) -> tuple[str, ...]:
    """Return the names of the planning options that apply to a kind of work."""
    return tuple(one.name for one in TABLE if one.group is Group.PLAN and kind in one.kinds)
