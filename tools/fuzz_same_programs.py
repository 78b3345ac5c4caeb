"""The same moves written in another way: the path, or the verdict, must be as before.

Comments, inches, other words for the same moves, a move split in two, a dwell of 0 where the
machine rests, a mirrored or a shifted path, axes renamed and in another order. Of most programs the
path is compared; every ``WHOLE``th is proved.
"""

from __future__ import annotations

import random
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from tools.fuzz_rewritten import DIALECTS, Style, moves_of, style_of, text_of

from threadline.jobs import read_job
from threadline.machine import Machine, load_machine
from threadline.machine.tool import eye_within
from threadline.motion.path import programmed_path
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, prove
from threadline.verdict import load_spec


@cache
def winder() -> Machine:
    """Return the winder of the library."""
    return load_machine("lathe-winder")


@cache
def loaded() -> None:
    """Load the machine code of the slowest interpolation, which takes seconds, before any case."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "short.nc"
        file.write_text("G21\nG91\nG1 X4 A6 F1800\nY-1\nM30\n")
        prove(file, winder(), load_spec(None, winder()), Options(interpolation="optimal"))


WHOLE = 16
"""One of so many cases goes all the way."""
SAME = 1e-6  # of a value: what noise of the size of rounding may change
_MOVED, _COUNTS = 0.1, 1e-4
"""Share of a value, and m or rad, by which a path that lies elsewhere between counts may differ."""
_OF_THE_PLACE = ("travel", "settling_time", "residual_vibration", "current_peak", "current_rms")
"""Where the work lies on the machine, and what hangs on a count or two."""
_OF_LINES = ("auto", "linear", "optimal", "parabolic")
"""Interpolations in which a move that is cut in two is the same path."""
_OF_POINTS = ("cubic", "quintic", "b-spline", "point-to-point", "law:modified-sine")
"""One more point is another path, or one more rest."""
_OF_THE_CUT = {
    "auto": ("acceleration", "deceleration", "jerk"),
    "linear": ("velocity", "acceleration", "deceleration", "jerk", "path_use"),
    "optimal": ("acceleration", "deceleration", "jerk"),
}
"""What the plan of a move that is cut in two may reach: ``auto`` rounds a corner within half of the
part beside it, so that a shorter part has a sharper curve; ``linear`` gives each part whole ticks,
and a part of three ticks may be a third slower or faster; ``optimal`` times a path of other pieces,
and a motion that is as fast may use less of a limit that does not bind."""
_AS_LONG = {"auto": 0.005, "optimal": 0.005, "parabolic": 0.03}
"""Share by which the time of a move that is cut in two may differ. ``linear`` may take one tick
longer for each cut."""
_SEARCHED = 5e-4
"""Share by which the time of an ``optimal`` plan may differ though nothing is cut: the search ends
near the least time, and rounding decides where it cuts the path."""

Key = tuple[str, str, str]
Outcomes = Mapping[Key, tuple[float | None, str, float | None]]

# --- verdicts ---


def outcomes_of_proof(proof: Proof) -> Outcomes:
    return {
        (r.name, r.axis, r.step): (r.measured, r.status.value, r.limit)
        for r in proof.verdict.results
    }


def same_verdicts(
    before: Outcomes, after: Outcomes, said: str, moved: bool = False, free: tuple[str, ...] = ()
) -> None:
    """Refuse verdicts that differ, but for the values of the criteria ``free``.

    A path that was ``moved`` lies elsewhere between the counts.
    """
    assert before.keys() == after.keys(), f"criteria {before.keys() ^ after.keys()}: {said}"
    for key, (value, status, limit) in before.items():
        now, other, _ = after[key]
        where = f"{' '.join(key)} is {now!r}, {other}, and was {value!r}, {status}"
        if (moved and key[0] in _OF_THE_PLACE) or key[0] in free:
            continue
        if value is None or now is None or value == now:
            assert value == now and status == other, f"{where}: {said}"
            continue
        room = _MOVED * abs(value) + _COUNTS if moved else SAME * abs(value) + 1e-9
        assert abs(now - value) <= room, f"{where}: {said}"
        assert status == other or abs(value - (limit or 0.0)) <= room, f"{where}: {said}"


# --- programs ---

_ALIKE = {"X": "Z", "Y": "Y", "A": "B"}


@dataclass(frozen=True)
class Twin:
    """The same moves on the same machine, of which neither is written as before.

    Attributes
    ----------
    machine, file
        With axes of other names, in another order.
    names
        The axes before, by their names.
    mirrored
        The axis that goes the other way, by its name; empty for none.
    """

    machine: Machine
    file: Path
    names: Mapping[str, str]
    mirrored: str

    def path(self, dialect: str) -> dict[str, np.ndarray]:
        """Return the way gone at each vertex, its time, and the places of the axes of before."""
        job = read_job(self.file, self.machine, dialect=dialect)
        path = programmed_path(job, self.machine)
        blocks = list(path)
        places = np.concatenate([b.positions for b in blocks])
        found = {
            self.names[axis]: places[:, k] * (-1 if axis == self.mirrored else 1)
            for k, axis in enumerate(path.axes)
        }
        ways = np.diff(places, axis=0, prepend=places[:1])
        found["way"] = np.cumsum(np.linalg.norm(ways, axis=1))
        found["time"] = np.cumsum(np.concatenate([b.nominal_s + b.dwell_s for b in blocks]))
        return found

    def verdict(self, options: Options) -> tuple[Outcomes, float]:
        """Return the verdict on it, with the axes of before, and its time, s."""
        proof = prove(self.file, self.machine, load_spec(None, self.machine), options)
        results = outcomes_of_proof(proof)
        own = {
            (name, self.names.get(axis, ""), step): v for (name, axis, step), v in results.items()
        }
        return own, float(proof.plan.duration_s)


def _renamed(rng: random.Random, machine: Machine) -> tuple[Machine, dict[str, str]]:
    """Return a machine with axes of other names in another order, and the names before."""
    names = {axis: rng.choice((axis, _ALIKE[axis])) for axis in machine.axes}
    order = rng.sample(sorted(names), len(names))
    inputs = {n: replace(one, axis=names[one.axis]) for n, one in machine.inputs.items()}
    axes = {names[axis]: machine.axes[axis] for axis in order}
    renamed = replace(
        machine, axes=axes, inputs=inputs, tool=eye_within(machine.tool, set(axes) & set(names))
    )
    return renamed, {new: old for old, new in names.items()}


def check_program(path: Path) -> None:
    """Write the same moves in two ways, and hold path, or verdict, of one against the other's.

    Raises
    ------
    AssertionError
        If they differ.
    """
    rng = random.Random(path.read_bytes())
    dialect, moves = rng.choice(DIALECTS), moves_of(rng)
    style = style_of(rng, moves, dialect)
    machine, names = _renamed(rng, winder())
    axes = {old: new for new, old in names.items()}
    mirrored = rng.choice(("", "", *(axes[axis] for axis in moves[0][1])))
    others = [
        (rapid, {axes[a]: -x if axes[a] == mirrored else x for a, x in place.items()}, feed)
        for rapid, place, feed in moves
    ]
    one = Twin(winder(), path.with_name("one.nc"), {axis: axis for axis in winder().axes}, "")
    two = Twin(machine, path.with_name("two.nc"), names, mirrored)
    one.file.write_text(text_of(rng, moves, Style(), dialect))
    two.file.write_text(text_of(rng, others, style, dialect))
    about = f"{dialect}, {style}, {names}, mirrored {mirrored!r}\n"
    about += f"{one.file.read_text()}\n{two.file.read_text()}"
    before, after = one.path(dialect), two.path(dialect)
    assert before.keys() == after.keys(), f"axes {list(before)} and {list(after)}: {about}"
    for name, values in before.items():
        there = np.interp(before["way"], after["way"], after[name])
        assert np.abs(there - values).max() < 1e-9, f"{name} is {there} and was {values}: {about}"
    if rng.randrange(WHOLE) == 0:
        kinds = _OF_LINES if style.split or rng.random() < 0.7 else _OF_POINTS
        options = Options(dialect=dialect, interpolation=rng.choice(kinds))
        by = "" if rng.random() < 0.5 else f"{axes['X']}={rng.randint(-20, 20)} mm"
        (verdict, before_s), (other, after_s) = (
            one.verdict(options), two.verdict(replace(options, offset=by or None))
        )  # fmt: skip
        sums = style.split or style.inches or style.absolute  # rounded elsewhere at half a count
        moved = bool(by or mirrored or sums)
        free = _OF_THE_CUT.get(options.interpolation, ()) if style.split else ()
        how = f"{options.interpolation}, shifted {by!r}"
        same_verdicts(verdict, other, f"{how}, {about}", moved, free)
        cuts = len(moves) if style.split else 0
        _as_long(before_s, after_s, options.interpolation, cuts, f"{how}, {about}")


def _as_long(before_s: float, after_s: float, kind: str, cuts: int, said: str) -> None:
    """Refuse a time that differs by more than so many moves that are cut in two explain."""
    tick_s = float(winder().tick_clock.period_s)
    share = _AS_LONG.get(kind, 0.0) if cuts else _SEARCHED * (kind == "optimal")
    room_s = (cuts * tick_s if kind == "linear" else 0.0) + share * before_s
    off_s = after_s - before_s
    assert abs(off_s) <= room_s + SAME * before_s, (
        f"takes {after_s} s, and took {before_s} s: {said}"
    )
