"""The same winding on another lathe, or seen in a mirror: the fibre must lie as before.

Axes renamed, in another order, counting the other way or from another zero; mandrel, eye and
program shifted along the machine, mirrored end for end, or turning the other way. The eye has at
random a roller, an arm and a place beside its carrier; chuck, tailstock, bosses and pins stand
near. What the planned motion lays is compared; every ``WHOLE``th is simulated and judged.
"""

from __future__ import annotations

import json
import random
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from tools.fuzz_runs import short_vessel
from tools.fuzz_same_programs import Outcomes, outcomes_of_proof, same_verdicts

from threadline.machine import Machine, load_machine
from threadline.machine.quantity import Provenance, Quantity
from threadline.machine.tool import Arm, EndStop, EyeAxis, Payout, Roller, Tool
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, prove, with_product
from threadline.units import parse_quantity
from threadline.verdict import load_spec
from threadline.verdict.fibre import MEASURED, PLANNED, measure_planned
from threadline.winding.product import product_of_text

WHOLE = 25
"""One of so many cases is simulated."""
_END_M = 0.3  # a mirror stands in its middle
_OUT_MM = 150  # across, while the eye goes to its place
_AXES = ("A", "X", "Y")
_OTHER = {"A": "B", "X": "Z", "Y": "U"}
_POLES = {"left": "right", "right": "left"}
_BY_DIRECTION = "pattern_closure"
"""A circuit begins where the fibre goes from left to right: the mirrored one begins elsewhere."""


@dataclass(frozen=True)
class Winding:
    """What is wound, and on what.

    Attributes
    ----------
    product
        Content of the product file.
    rows
        (n, 3) turn, deg, and places of the eye along and across, mm, to three digits.
    machine
        A machine with the eye.
    names
        Names of the axes that turn the mandrel and move the eye.
    """

    product: Mapping[str, Any]
    rows: np.ndarray
    machine: Machine
    names: tuple[str, str, str] = _AXES

    @property
    def tool(self) -> Tool:
        """The eye."""
        assert self.machine.tool is not None
        return self.machine.tool

    def with_tool(self, **changed: Any) -> Winding:
        """Return the winding on a machine with another eye."""
        return replace(self, machine=replace(self.machine, tool=replace(self.tool, **changed)))

    @property
    def text(self) -> str:
        """The program: out, along, in, a rest, and the rows, in steps."""
        a, x, y = self.names
        (_, along, across), steps = self.rows[0], np.diff(self.rows, axis=0)
        assert self.tool.across is not None
        out = _OUT_MM * self.tool.across.factor
        lines = ["G21", "G91", "G1 F9000", f"{y}{out:.0f}", f"{x}{along:.3f}"]
        lines += [f"{y}{across - out:.3f}", "G4 P1"]
        lines += [
            " ".join(f"{n}{v:.3f}" for n, v in zip((a, x, y), row, strict=True) if abs(v) > 5e-4)
            for row in steps
        ]
        return "\n".join([*filter(None, lines), "M30", ""])

    def outcomes(self, file: Path, *, whole: bool) -> Outcomes:
        """Return what its planned motion lays, or the whole verdict."""
        file.write_text(self.text)
        options = Options(product=json.dumps(self.product), interpolation="linear")
        if not whole:
            plan = plan_job(open_job(file, self.machine, options), self.machine, options)
            return {
                (name, "", ""): (found.value, "", None)
                for name, (found,) in measure_planned(plan).items()
            }
        spec = with_product(load_spec(None, self.machine), self.machine, options)
        of_fibre = tuple(c for c in spec.criteria if c.name in (*MEASURED, *PLANNED))
        spec = replace(spec, criteria=of_fibre)
        verdict = outcomes_of_proof(prove(file, self.machine, spec, options))
        own = dict(zip(self.names, _AXES, strict=True))
        return {(name, own.get(axis, ""), step): v for (name, axis, step), v in verdict.items()}


# --- what is wound ---


@cache
def _lathe() -> Machine:
    """Return the winder of the library with room to both sides, and without switches there."""
    machine = load_machine("lathe-winder")
    x = machine.axes["X"]
    assert x.travel is not None and machine.axes["Y"].travel is not None
    room = replace(x.travel[0], si=-1.0), replace(x.travel[1], si=1.0)
    wider = {name: replace(machine.axes[name], travel=room) for name in ("X", "Y")}
    return replace(machine, axes={**machine.axes, **wider}, inputs={})


def winding_of(rng: random.Random) -> Winding:
    """Return a winding with a fault or two, by an eye that stands a little elsewhere."""
    text, circuit = short_vessel()
    product = json.loads(text)
    rows = np.vstack([circuit, circuit[1:] + np.array([circuit[-1, 0] - circuit[0, 0], 0.0, 0.0])])
    rows = np.round(rows[: rng.randint(8, len(rows))] * [np.degrees(1.0), 1e3, 1e3], 3)
    rows[:, 0] -= rows[0, 0]
    for _ in range(rng.choice((0, 0, 1, 2))):
        column, first = rng.randrange(3), rng.randrange(1, len(rows))
        rows[first:, column] += round(rng.uniform(-6.0, 6.0), 3)
    product["mandrel"]["slip"] = f"{rng.choice((0.0, 0.5, -0.7))} deg"
    product["friction"]["value"] = f"{rng.choice((0.1, 0.3, 0.6))} +- 0.05"
    if rng.random() < 0.5:
        product["boss"] = [{"at": "-8 mm", "length": "5 mm", "radius": "20 mm"}]
        product["pin"] = [{"at": "40 mm", "radius": "52 mm", "diameter": "2 mm"}]
    if rng.random() < 0.3:
        product["part"][1:2] = _waist()
    if rng.random() < 0.3:
        del product["fibre"]["tied"]
    wound = Winding(product, np.round(rows, 3), _lathe())
    if rng.random() < 0.5:
        return wound
    body = _m(rng.choice((2e-3, 6e-3)))
    stop = EndStop(at=_m(0.08), radius=_m(0.03), length=_m(0.04))
    return wound.with_tool(
        payout=Payout(**{k: _m(rng.uniform(-4e-3, 4e-3)) for k in ("along", "across", "up")}),
        roller=Roller(
            radius=_m(rng.choice((0.0, 3e-3))), axis=rng.choice(("along", "up")),
            side="+" if rng.random() < 0.5 else "-",
        ),
        body=body,
        arm=Arm(radius=body, length=_m(0.05)),
        chuck=rng.choice((None, stop)),
        tailstock=rng.choice((None, replace(stop, at=_m(0.21)))),
    )  # fmt: skip


def _waist() -> list[dict[str, str]]:
    wide, narrow = "50 mm", "48 mm"
    return [
        {"kind": "cone", "radius": wide, "end_radius": narrow, "length": "5 mm"},
        {"kind": "cone", "radius": narrow, "end_radius": wide, "length": "7 mm"},
    ]


def _m(si: float) -> Quantity:
    return Quantity(si=si, unit="m", tolerance_si=0.0, provenance=Provenance.ASSUMED)


def _si(text: str) -> float:
    return float(parse_quantity(text.partition("+-")[0].strip(), "m"))


def _moved(text: str, si: float) -> str:
    """Return a place with its tolerance, elsewhere."""
    _, plus, tolerance = text.partition("+-")
    return f"{si!r} m {plus}{tolerance}".strip()


# --- what must not matter ---


def shifted(rng: random.Random, wound: Winding) -> Winding:
    """Return everything further along the machine."""
    by = rng.choice((-20, 15, 60))
    mandrel, tool = wound.product["mandrel"], wound.tool
    mandrel = {**mandrel, "at": _moved(mandrel["at"], _si(mandrel["at"]) + 1e-3 * by)}
    stops = {
        name: replace(stop, at=_m(stop.at.si + 1e-3 * by))
        for name in ("chuck", "tailstock")
        if (stop := getattr(tool, name)) is not None
    }
    rows = wound.rows + np.array([0, by, 0])
    moved = replace(wound, product={**wound.product, "mandrel": mandrel}, rows=rows)
    return moved.with_tool(**stops)


def end_for_end(_: random.Random, wound: Winding) -> Winding:
    """Return everything mirrored along the machine."""
    product = dict(wound.product)
    surface = product_of_text(json.dumps(product)).surface
    long = float(surface.at(np.array([surface.length_m]))[0][0, 0])

    def back(text: str, less: float = 0.0) -> str:
        return _moved(text, long - _si(text) - less)

    product["mandrel"] = {**product["mandrel"]}
    at = product["mandrel"]["at"]
    product["mandrel"]["at"] = _moved(at, _END_M - _si(at) - long)
    product["part"] = [_turned_round(part) for part in reversed(product["part"])]
    for name, size in (("boss", "length"), ("pin", "")):
        product[name] = [
            {**one, "at": back(one["at"], _si(one[size]) if size else 0.0)}
            for one in product.get(name, ())
        ]
    if "tied" in product["fibre"]:
        product["fibre"] = {**product["fibre"], "tied": back(product["fibre"]["tied"])}
    cover = product["coverage"]
    product["coverage"] = {**cover, "begin": back(cover["end"]), "end": back(cover["begin"])}
    rows = wound.rows * [1.0, -1.0, 1.0] + [0.0, 1e3 * _END_M, 0.0]
    tool = wound.tool
    changed: dict[str, Any] = {
        there: None if (stop := getattr(tool, here)) is None
        else replace(stop, at=_m(_END_M - stop.at.si))
        for here, there in (("chuck", "tailstock"), ("tailstock", "chuck"))
    }  # fmt: skip
    mirrored = _mirrored_eye(tool, "along", "up")
    return replace(wound, product=product, rows=rows).with_tool(**changed, **mirrored)


def _turned_round(part: Mapping[str, str]) -> dict[str, str]:
    found = dict(part)
    if "pole" in part:
        found["pole"] = _POLES[part["pole"]]
    if "end_radius" in part:
        found["radius"], found["end_radius"] = part["end_radius"], part["radius"]
    return found


def _mirrored_eye(tool: Tool, way: str, axis: str) -> dict[str, Any]:
    """Return payout and roller mirrored in one direction; a roller about ``axis`` changes sides."""
    found: dict[str, Any] = {}
    if tool.payout is not None:
        found["payout"] = replace(tool.payout, **{way: _m(-getattr(tool.payout, way).si)})
    if tool.roller is not None and tool.roller.axis == axis:
        found["roller"] = replace(tool.roller, side="-" if tool.roller.side == "+" else "+")
    return found


def the_other_way_round(_: random.Random, wound: Winding) -> Winding:
    """Return a winding on a mandrel that turns the other way, mirrored upside down."""
    mirrored = _mirrored_eye(wound.tool, "up", "along")
    return replace(wound, rows=wound.rows * [-1.0, 1.0, 1.0]).with_tool(**mirrored)


def counted_back(rng: random.Random, wound: Winding) -> Winding:
    """Return a machine on which an axis counts the other way, or from another zero."""
    column = rng.randrange(3)
    name = ("turn", "along", "across")[column]
    by = 0 if column == 0 else rng.choice((0, 0, 25, -40))
    part: EyeAxis = getattr(wound.tool, name)
    rows = wound.rows.copy()
    if rng.random() < 0.6:
        rows[:, column] *= -1.0
        part = replace(part, reverse=not part.reverse)
    rows[:, column] -= by * part.factor
    zero = None if column == 0 else replace(part.zero or _m(0.0), si=part.zero_si + 1e-3 * by)
    return replace(wound, rows=rows).with_tool(**{name: replace(part, zero=zero)})


def renamed(rng: random.Random, wound: Winding) -> Winding:
    """Return a machine with axes of other names, in another order."""
    names = {n: rng.choice((n, _OTHER[n])) if n in _OTHER else n for n in wound.names}
    order = rng.sample(wound.names, 3)
    machine, tool = wound.machine, wound.tool
    parts = {
        name: replace(part, axis=names[part.axis])
        for name in ("turn", "along", "across")
        if (part := getattr(tool, name)) is not None
    }
    axes = {names[n]: machine.axes[n] for n in order}
    machine = replace(machine, axes=axes, tool=replace(tool, **parts))
    a, x, y = (names[n] for n in wound.names)
    return replace(wound, machine=machine, names=(a, x, y))


_CHANGES = (shifted, end_for_end, the_other_way_round, counted_back, renamed)
"""In this order: what moves the eye takes its axes as they were."""


def check_winding(path: Path) -> None:
    """Hold what a winding lays against the same winding made or seen otherwise.

    Raises
    ------
    AssertionError
        If they differ.
    """
    rng = random.Random(path.read_bytes())
    one = two = winding_of(rng)
    changes = sorted(rng.sample(_CHANGES, rng.choice((1, 1, 2, 3))), key=_CHANGES.index)
    for change in changes:
        two = change(rng, two)
    whole = rng.randrange(WHOLE) == 0
    before = one.outcomes(path.with_name("one.nc"), whole=whole)
    after = two.outcomes(path.with_name("two.nc"), whole=whole)
    free = tuple(k[0] for k in before if k[0].endswith(_BY_DIRECTION) and end_for_end in changes)
    names = " ".join(change.__name__ for change in changes)
    digest = f"{names}\n{json.dumps(one.product)}\n{one.tool}\n{one.text}\n"
    digest += f"{json.dumps(two.product)}\n{two.tool}\n{two.text}"
    # Simulated, the axes round to other counts.
    same_verdicts(before, after, digest, moved=whole, free=free)
