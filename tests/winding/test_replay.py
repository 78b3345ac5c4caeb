"""The replay, compared with closed forms, printed figures and a Cartesian integrator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.winding.cartesian import (
    Quadric,
    Roller,
    cone,
    cylinder,
    ellipsoid,
    eye_in_mandrel,
    laid,
    tangent_at,
)
from threadline.base.arrays import FloatArray
from threadline.machine import load_machine
from threadline.machine.quantity import Quantity, parse_machine_quantity
from threadline.machine.tool import Payout, Tool
from threadline.machine.tool import Roller as TubeRoller
from threadline.winding.laying import BRIDGED, LAID, LIFTED, OFF, SUNK
from threadline.winding.replay import Fibre, Replay
from threadline.winding.shapes import ellipse
from threadline.winding.surface import Stretch, Surface, line, surface_of

TOOL = load_machine("lathe-winder").tool
assert TOOL is not None


def _mm(value: float) -> Quantity:
    return parse_machine_quantity(f"{value} mm exact, assumed: a test", ("m",))


def _surface(*parts: Stretch) -> Surface:
    return surface_of(parts, 1e-3)


def _replayed(surface: Surface, eyes: FloatArray, tied: float | None = None) -> Fibre:
    return Replay(surface, TOOL, 10.0, tied).feed(eyes)


def _places(surface: Surface, fibre: Fibre) -> FloatArray:
    x, r = (values[:, 0] for values in surface.at(fibre.u))
    return np.column_stack([x, r * np.cos(fibre.angle), r * np.sin(fibre.angle)])


def _planned(
    meridian: Callable[[float], tuple[float, float, float, float]],
    start: tuple[float, float],
    ratio: float,
    steps: int,
    step: float = 1e-3,
) -> FloatArray:
    """Return (n, 4) places, angles round, angles from the meridian and radii of a friction path.

    ``meridian`` gives x, r, the meridian's angle and its curvature at a length along it. A fibre
    with k_g / k_n = ratio turns by k_g less r' / r sin(angle).
    """

    def rates(_: float, y: FloatArray) -> list[float]:
        _, r, slope, bend = meridian(y[0])
        cos, sin = np.cos(y[2]), np.sin(y[2])
        normal = bend * cos**2 + np.cos(slope) / r * sin**2
        return [cos, sin / r, ratio * normal - np.sin(slope) / r * sin]

    found = solve_ivp(
        rates, (0.0, step * steps), [start[0], 0.0, start[1]],
        t_eval=step * np.arange(steps + 1), rtol=1e-11, atol=1e-13,
    )  # fmt: skip
    return np.asarray(found.y.T)


def _eyes_on_circle(path: FloatArray, radius: float, away: float) -> FloatArray:
    """Return the eye at a radius ``away`` beside a cylinder, ahead on the fibre."""
    beyond = np.sqrt(away**2 - radius**2)
    eyes = np.zeros((len(path), 6))
    eyes[:, 0] = -(path[:, 1] + np.arctan2(beyond, radius))
    eyes[:, 1] = path[:, 0] + beyond / np.tan(path[:, 2])
    eyes[:, 2] = away
    return eyes


@pytest.mark.parametrize("ratio", [0.2, -0.2, 0.0])
def test_a_friction_path_on_a_cylinder_comes_back(ratio: float) -> None:
    """The mean is within 0.003 of the planned ratio, the place within 0.005 mm."""
    radius = 0.05
    surface = _surface(line(-0.5, radius, 1.0, radius))
    path = _planned(lambda u: (u, radius, 0.0, 0.0), (0.0, 0.6), ratio, 400)
    fibre = _replayed(surface, _eyes_on_circle(path, radius, 0.055), tied=0.0)

    steer = fibre.steer[np.isfinite(fibre.steer)]
    assert np.abs(steer - ratio).max() < 0.0005
    places = _places(surface, fibre)[1:]
    assert np.abs(places[:, 0] - path[1:, 0]).max() < 5e-6
    assert radius * np.abs(fibre.angle[1:] - path[1:, 1]).max() < 5e-6


def test_the_wobble_on_a_cylinder_is_the_printed_one() -> None:
    """Linear axes with steps of 1 mm: 0.1965 to 0.2044 on a radius of 50 mm, the eye at 55 mm."""
    radius = 0.05
    surface = _surface(line(-0.5, radius, 1.0, radius))
    path = _planned(lambda u: (u, radius, 0.0, 0.0), (0.0, 0.6), 0.2, 400)
    fibre = _replayed(surface, _eyes_on_circle(path, radius, 0.055), tied=0.0)

    assert np.nanmin(fibre.least) == pytest.approx(0.1965, abs=0.001)
    assert np.nanmax(fibre.most[np.isfinite(fibre.most)]) == pytest.approx(0.2044, abs=0.001)
    halved = _planned(lambda u: (u, radius, 0.0, 0.0), (0.0, 0.6), 0.2, 800, 5e-4)
    finer = _replayed(surface, _eyes_on_circle(halved, radius, 0.055), tied=0.0)
    wide = np.nanmax((fibre.most - fibre.least)[np.isfinite(fibre.steer)])
    narrow = np.nanmax((finer.most - finer.least)[np.isfinite(finer.steer)])
    assert narrow == pytest.approx(0.5 * wide, rel=0.1)


def _hemisphere(ratio: float, angle: float = 0.7) -> tuple[Surface, FloatArray, FloatArray]:
    """Return a hemisphere of 100 mm, a friction path on it, and the eye on a sphere of 130 mm."""
    radius, away = 0.1, 0.13
    surface = _surface(
        line(-0.2, radius, 0.0, radius), ellipse(0.0, radius, radius, 0.01, left=False)
    )

    def meridian(u: float) -> tuple[float, float, float, float]:
        return radius * np.sin(u / radius), radius * np.cos(u / radius), -u / radius, 1.0 / radius

    path = _planned(meridian, (0.0, angle), ratio, 150)
    free = np.sqrt(away**2 - radius**2)
    slope = -path[:, 0] / radius
    along, out = radius * np.sin(-slope), radius * np.cos(slope)
    cos, sin = np.cos(path[:, 2]), np.sin(path[:, 2])
    x = along + free * cos * np.cos(slope)
    away_r, away_c = out + free * cos * np.sin(slope), free * sin
    eyes = np.zeros((len(path), 6))
    eyes[:, 0] = -(path[:, 1] + np.arctan2(away_c, away_r))
    eyes[:, 1] = x
    eyes[:, 2] = np.hypot(away_r, away_c)
    places = np.column_stack([along, out * np.cos(path[:, 1]), out * np.sin(path[:, 1])])
    return surface, eyes, places


@pytest.mark.parametrize("angle", [0.3, 0.7])
def test_a_friction_path_on_a_hemisphere_comes_back(angle: float) -> None:
    """Printed: the ratio varies from 0.180 to 0.215, and its mean stays within 0.0025.

    The start of this path is not printed: a steeper start varies more.
    """
    surface, eyes, places = _hemisphere(0.2, angle)
    fibre = _replayed(surface, eyes, tied=0.0)

    steer = fibre.steer[np.isfinite(fibre.steer)]
    assert len(steer) > 100
    assert np.abs(steer - 0.2).max() < 0.0025
    least = np.nanmin(fibre.least[np.isfinite(fibre.least)])
    most = np.nanmax(fibre.most[np.isfinite(fibre.most)])
    if angle == 0.3:
        assert least == pytest.approx(0.180, abs=0.004)
        assert most == pytest.approx(0.215, abs=0.004)
    else:
        assert 0.180 < least < 0.2 < most < 0.215
    assert np.abs(_places(surface, fibre)[1:] - places[1:]).max() < 5e-6


def test_a_constant_ratio_on_a_sphere_is_a_circle() -> None:
    """A path of constant k_g / k_n = l on a sphere is a circle of radius R / sqrt(1 + l^2)."""
    surface, eyes, _ = _hemisphere(0.2)
    found = _places(surface, _replayed(surface, eyes, tied=0.0))[1:]
    centred = found - found.mean(axis=0)
    normal = np.linalg.svd(centred)[2][2]
    assert np.abs(centred @ normal).max() < 5e-6
    distance = abs(float(found.mean(axis=0) @ normal))
    assert np.sqrt(0.1**2 - distance**2) == pytest.approx(0.1 / np.sqrt(1.04), abs=5e-6)


def test_a_constant_ratio_on_a_cone_keeps_its_invariant() -> None:
    """On a cone (1 / sin a - l cot tau) / r is constant, tau the half angle of its apex."""
    tau, ratio = 0.4, 0.15
    slope = np.tan(tau)
    surface = _surface(line(0.0, 0.2 * slope, 0.4, 0.6 * slope))

    def meridian(u: float) -> tuple[float, float, float, float]:
        return u * np.cos(tau), 0.2 * slope + u * np.sin(tau), tau, 0.0

    path = _planned(meridian, (0.05, 1.0), ratio, 250)
    cos, sin = np.cos(path[:, 2]), np.sin(path[:, 2])
    radius, free = 0.2 * slope + path[:, 0] * np.sin(tau), 0.02
    eyes = np.zeros((len(path), 6))
    out, aside = radius + free * cos * np.sin(tau), free * sin
    eyes[:, 0] = -(path[:, 1] + np.arctan2(aside, out))
    eyes[:, 1] = path[:, 0] * np.cos(tau) + free * cos * np.cos(tau)
    eyes[:, 2] = np.hypot(out, aside)
    fibre = _replayed(surface, eyes)
    known = fibre.known
    assert known.sum() > 100

    r = surface.at(fibre.u[known])[1][:, 0]
    kept = (1.0 / np.sin(fibre.winding[known]) - ratio / np.tan(tau)) / r
    # A tenth of the bar on the ratio, over this path of 250 mm.
    assert np.ptp(kept) / kept.mean() < 3e-3
    steer = fibre.steer[known & np.isfinite(fibre.steer)]
    assert np.abs(steer - ratio).max() < 0.003


def _wavy(time: FloatArray | float) -> FloatArray:
    """Return an eye that accelerates, sways and rises, far from any friction path."""
    t = np.asarray(time, dtype=np.float64)
    turn = -1.3 * t + 0.15 * np.sin(1.1 * t)
    along = 0.01 * t + 0.004 * np.sin(0.9 * t)
    across = 0.14 + 0.006 * np.sin(0.7 * t)
    return np.stack([turn, along, across, 0.02 + 0.004 * np.sin(1.7 * t), 0.0 * t, 0.0 * t], -1)


@pytest.mark.parametrize(
    ("surface", "quadric"),
    [
        (_surface(line(-0.4, 0.1, 0.9, 0.1)), cylinder(0.1)),
        (_surface(line(-0.4, 0.06, 0.6, 0.11)), cone(-0.4 - 0.06 / 0.05, 0.05)),
        (
            _surface(
                ellipse(0.05, 0.1, 0.25, 0.02, left=True),
                ellipse(0.05, 0.1, 0.25, 0.02, left=False),
            ),
            ellipsoid(0.05, 0.25, 0.1),
        ),
    ],
    ids=["cylinder", "cone", "ellipsoid"],
)
def test_replay_agrees_with_a_cartesian_integrator(surface: Surface, quadric: Quadric) -> None:
    """Any motion of the eye: within 1 um of a string on an implicit surface, from a tied start.

    The start is the point at which the mandrel has turned by 0.1 mm, where winding begins.
    """
    along = -0.03
    u = surface.place_of(np.array([along]))
    x, r = (float(values[0, 0]) for values in surface.at(u))
    until, count = 12.0, 60_000
    times = np.linspace(0.0, until, count + 1)
    fibre = _replayed(surface, _wavy(times), tied=along)
    first = int(np.argmax(fibre.state == LAID))
    begin_s = float(times[first - 1])
    assert 0.0 <= begin_s < 0.1
    start = tangent_at(quadric, eye_in_mandrel(_wavy(begin_s)), x, r)
    expected = laid(quadric, lambda t: _wavy(t + begin_s), start, until)(times[first:] - begin_s)

    found = _places(surface, fibre)[first:]
    assert (fibre.state[first:] == LAID).all()
    # The blocks are chords of 0.2 ms of the smooth motion: far below the bar.
    assert np.abs(found - expected).max() < 1e-6


_EGG = _surface(
    ellipse(0.05, 0.1, 0.25, 0.02, left=True), ellipse(0.05, 0.1, 0.25, 0.02, left=False)
)


def _turning(time: FloatArray | float) -> FloatArray:
    """Return ``_wavy`` with a carrier that yaws and rolls."""
    t = np.asarray(time, dtype=np.float64)
    eyes = _wavy(t)
    eyes[..., 4], eyes[..., 5] = 0.3 * np.sin(0.8 * t), 0.2 * np.sin(0.6 * t)
    return eyes


@pytest.mark.long(but="along--")
@pytest.mark.parametrize(("axis", "side"), [("along", "+"), ("along", "-"), ("up", "+")])
def test_a_roller_agrees_with_its_tangent_in_space(axis: str, side: str) -> None:
    """The fibre runs to its tangent point, a root, on a roller of 8 mm that yaws and rolls."""
    quadric, surface = ellipsoid(0.05, 0.25, 0.1), _EGG
    tool = Tool(
        kind="eye", radius=TOOL.radius, turn=TOOL.turn, along=TOOL.along, across=TOOL.across,
        payout=Payout(along=_mm(5.0), across=_mm(-10.0), up=_mm(3.0)),
        roller=TubeRoller(radius=_mm(8.0), axis=axis, side=side),
    )  # fmt: skip
    directions = {"along": np.array([1.0, 0.0, 0.0]), "up": np.array([0.0, 0.0, 1.0])}
    way = (1.0 if side == "+" else -1.0) * directions["up" if axis == "along" else "along"]
    roller = Roller(np.array([5e-3, -1e-2, 3e-3]), directions[axis], 8e-3, way)
    until, count = 5.0, 25_000
    times = np.linspace(0.0, until, count + 1)
    fibre = Replay(surface, tool, 10.0, -0.03).feed(_turning(times))
    first = int(np.argmax(fibre.state == LAID))
    assert (fibre.state[first:] == LAID).all()
    found = _places(surface, fibre)
    start = found[first]
    eye = roller.leaves(_turning(times[first]), start)
    gradient = quadric.gradient(start)
    # The first place lies on a common tangent, and the rest follow from it.
    away = eye - start
    assert abs(gradient @ away) < 1e-6 * np.linalg.norm(gradient) * np.linalg.norm(away)
    begin_s = float(times[first])
    path = laid(quadric, lambda t: _turning(t + begin_s), start, until - begin_s, roller)
    assert np.abs(found[first:] - path(times[first:] - begin_s)).max() < 1e-6
    # Without its radius it is the plain eye at its centre.
    flat = replace(tool, roller=TubeRoller(radius=_mm(0.0), axis=axis, side=side))
    plain = Replay(surface, replace(tool, roller=None), 10.0, -0.03).feed(_turning(times[:500]))
    bare = Replay(surface, flat, 10.0, -0.03).feed(_turning(times[:500]))
    np.testing.assert_array_equal(bare.u, plain.u)


def test_the_roller_gives_out_what_the_taut_fibre_takes() -> None:
    """The given-out fibre is the growth of laid, free and wound-round length, the shortest way."""
    radius, size = 0.05, 8e-3
    surface = _surface(line(-0.5, radius, 1.0, radius))
    tool = replace(TOOL, roller=TubeRoller(radius=_mm(1e3 * size), axis="along", side="+"))
    eyes = np.zeros((401, 6))
    share = np.linspace(0.0, 1.0, 401)
    eyes[:, 0], eyes[:, 2], eyes[:, 3] = -3.0 * share, 0.07 + 0.02 * share, 0.01 * share
    fibre = Replay(surface, tool, 10.0, 0.0).feed(eyes)
    # In the plane: laid below the axis, the fibre crosses to the upper side of the roller.
    distance, level = np.hypot(eyes[:, 2], eyes[:, 3]), np.arctan2(eyes[:, 3], eyes[:, 2])
    assert fibre.angle[-1] + eyes[-1, 0] < 0.0
    free = np.sqrt(distance**2 - (radius + size) ** 2)
    arc = size * (level + np.arcsin((radius + size) / distance))
    length = fibre.length_m + free + arc
    laid = fibre.state == LAID
    used = fibre.used_m[laid][5:]
    np.testing.assert_allclose(used, np.diff(length)[-len(used) :], atol=1e-8)


def test_a_wrong_start_is_forgotten_with_the_free_length() -> None:
    """The error of a wrong start decays as exp(-laid length / free length)."""
    radius = 0.05
    surface = _surface(line(-0.5, radius, 3.0, radius))
    path = _planned(lambda u: (u, radius, 0.0, 0.0), (0.0, 0.9), 0.0, 800)
    eyes = _eyes_on_circle(path, radius, 0.055)
    true = _replayed(surface, eyes, tied=0.0)
    wrong = _replayed(surface, eyes, tied=0.002)

    # The place along the fibre's normal decays; compare the places of equal blocks.
    off = np.linalg.norm(_places(surface, true) - _places(surface, wrong), axis=1)[1:]
    free = float(true.free_m[-1])
    at = true.length_m[1:]
    one, five = int(np.searchsorted(at, free)), int(np.searchsorted(at, 5.0 * free))
    assert off[one] / off[0] == pytest.approx(np.exp(-1.0), rel=0.15)
    assert off[five] / off[0] < 1.5 * np.exp(-5.0)
    guessed = _replayed(surface, eyes)
    assert guessed.known.any() and not guessed.known[: five // 2].any()
    first = int(np.argmax(guessed.known))
    assert guessed.length_m[first] == pytest.approx(5.0 * free, rel=0.05)


def test_unwinding_is_lifting_and_then_not_known() -> None:
    radius = 0.05
    surface = _surface(line(-0.5, radius, 1.0, radius))
    path = _planned(lambda u: (u, radius, 0.0, 0.0), (0.0, 0.9), 0.0, 300)
    eyes = _eyes_on_circle(path, radius, 0.052)
    back = eyes[200:180:-1]
    program = np.vstack([eyes[:201], back, eyes[181:]])
    fibre = _replayed(surface, program, tied=0.0)

    lifted = np.flatnonzero(fibre.state == LIFTED)
    assert lifted[0] == 202  # the first block takes the fibre back by 1 mm
    assert fibre.lifted_m.max() == pytest.approx(0.02, abs=2e-3)
    assert fibre.known[1:202].all()
    assert not fibre.known[lifted[0] + 1 : lifted[-1] + 10].any()
    assert fibre.known[-1]
    assert np.nanmax(fibre.slack_m) > 0.015


def test_a_hollow_is_bridged_with_its_height() -> None:
    """Two cones meet in a waist: the fibre spans it as a straight line between the rims."""
    surface = surface_of(
        [
            line(-0.1, 0.05, 0.0, 0.05),
            line(0.0, 0.05, 0.04, 0.045),
            line(0.04, 0.045, 0.08, 0.05),
            line(0.08, 0.05, 0.3, 0.05),
        ],
        1e-3,
    )
    assert not surface.convex
    angle, away = 0.25, 0.06
    free = np.sqrt(away**2 - 0.05**2)
    # A geodesic on the cylinder, continued as if there were no waist.
    places = np.arange(-0.08, 0.2, 1e-3)
    eyes = np.zeros((len(places), 6))
    eyes[:, 0] = -(places * np.tan(angle) / 0.05)
    eyes[:, 1] = places + free / np.tan(angle)
    eyes[:, 2] = away
    fibre = _replayed(surface, eyes)
    bridged = np.flatnonzero(fibre.state == BRIDGED)
    assert len(bridged) == 1
    # Straight from the last place, on the cone after the rim, to the eye at this block's end.
    at = int(bridged[0])
    near = _places(surface, fibre)[at - 1]
    heights = []
    for block in (at - 1, at):
        eye = eye_in_mandrel(eyes[block])
        points = near + np.linspace(0.0, 1.0, 20_001)[:, None] * (eye - near)
        hollow = np.interp(points[:, 0], [0.0, 0.04, 0.08], [0.05, 0.045, 0.05])
        heights.append((points[:, 0], np.hypot(points[:, 1], points[:, 2]) - hollow))
    (x, over), (_, later) = heights
    ahead = x > 0.02
    assert over[ahead].min() > -1e-5  # one block earlier it does not touch the far rim
    assert later[ahead].min() < 5e-4
    assert fibre.bridge_m.max() == pytest.approx(over[x < 0.08].max(), abs=4e-4)
    far = float(surface.at(fibre.u[at : at + 1])[0][0, 0])
    assert far == pytest.approx(0.08, abs=3e-3)


def test_an_eye_that_sinks_into_the_mandrel_lays_nothing_more() -> None:
    """It moves from 60 mm to 40 mm from the axis of a cylinder of 50 mm, while that turns on."""
    radius = 0.05
    surface = _surface(line(-0.5, radius, 1.0, radius))
    eyes = np.zeros((400, 6))
    eyes[:, 0] = -0.05 * np.arange(400)
    eyes[:, 2] = 0.06 - 0.02 * np.clip((np.arange(400) - 300) / 50.0, 0.0, 1.0)
    fibre = _replayed(surface, eyes, tied=0.0)
    inside = eyes[:, 2] < radius - 1e-4
    assert (fibre.state[inside] == SUNK).sum() == 1
    assert fibre.state[int(np.argmax(inside))] == SUNK
    assert fibre.known[1 : int(np.argmax(inside)) - 1].all()
    assert not fibre.known[inside].any()
    # Nothing is laid or given out from there on, and before it at most the mandrel's turn.
    assert np.nanmax(np.abs(fibre.used_m)) < 2.0 * 0.05 * 0.05


def test_a_fibre_that_runs_off_the_mandrel_is_said() -> None:
    radius = 0.05
    surface = _surface(line(0.0, radius, 0.1, radius))
    path = _planned(lambda u: (u, radius, 0.0, 0.0), (0.02, 0.5), 0.0, 200)
    fibre = _replayed(surface, _eyes_on_circle(path, radius, 0.055), tied=0.02)
    assert (fibre.state == OFF).sum() >= 1
    first = int(np.argmax(fibre.state == OFF))
    assert path[first, 0] == pytest.approx(0.1, abs=2e-3)


def test_an_eye_beside_the_mandrel_is_not_looked_at_in_every_block() -> None:
    """The fibre is found again within a quarter of the eye's distance from the axis."""
    radius, away, step = 0.05, 0.08, 1e-3
    surface = _surface(line(0.0, radius, 1.0, radius))
    beside, back = np.full(4000, 1.3), 1.3 - step * np.arange(1, 901)
    eyes = np.zeros((4900, 6))
    eyes[:, 0] = -step / radius * np.arange(4900)
    eyes[:, 1], eyes[:, 2] = np.concatenate([beside, back]), away
    fibre = _replayed(surface, eyes)
    looked = (fibre.state[:4000] == OFF).sum()
    assert 16 < looked < 4000 / 10
    # Where the eye alone comes back, the fibre is laid from the same place on.
    one_by_one = _replayed(surface, eyes[4000:])
    first, sooner = (
        len(state) - int(np.argmax(state[::-1] != LAID))
        for state in (fibre.state, one_by_one.state)
    )
    assert (first - 4000 - sooner) * step * np.hypot(1.0, away / radius) <= 0.25 * away + 2e-3
    known = fibre.known[4000:] & one_by_one.known
    assert known.sum() > 300
    both = (one_by_one.u - fibre.u[4000:])[known]
    assert np.abs(both).max() < 2e-3
    assert abs(both[-1]) < 1e-5


def test_an_eye_above_its_path_lays_behind_it() -> None:
    """A planner puts the eye radially above each point of a helix.

    The winding angle comes out as planned. The fibre lies behind the point by acos(R / eye radius)
    round the mandrel, and by sqrt(eye radius^2 - R^2) / tan(angle) along it.
    """
    radius, away, angle = 0.04, 0.05, np.radians(58.337)
    surface = _surface(line(-0.5, radius, 1.0, radius))
    along = np.arange(0.0, 0.3, 5e-3)
    turn = along * np.tan(angle) / radius
    eyes = np.zeros((len(along), 6))
    eyes[:, 0], eyes[:, 1], eyes[:, 2] = -turn, along, away
    fibre = _replayed(surface, eyes)
    known = fibre.known
    assert known.sum() > 20
    np.testing.assert_allclose(fibre.winding[known], angle, atol=1e-4)
    np.testing.assert_allclose(turn[known] - fibre.angle[known], np.arccos(0.8), atol=1e-4)
    behind = along[known] - surface.at(fibre.u[known])[0][:, 0]
    np.testing.assert_allclose(behind, 0.03 / np.tan(angle), atol=2e-5)


def test_reading_in_parts_is_reading_at_once() -> None:
    surface, eyes, _ = _hemisphere(0.1)
    whole = _replayed(surface, eyes, tied=0.0)
    replay = Replay(surface, TOOL, 10.0, 0.0)
    parts = [replay.feed(part) for part in np.array_split(eyes, 7)]
    np.testing.assert_allclose(np.concatenate([p.u for p in parts]), whole.u, atol=1e-12)
    np.testing.assert_allclose(np.concatenate([p.angle for p in parts]), whole.angle, atol=1e-12)
