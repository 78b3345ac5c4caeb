"""The batch by JAX: ``vmap``-like arrays of variants, ``lax.scan`` over ticks, float64, jitted.

Variants are the last axis and matrices are unrolled to scalars, zeros and ones left out: the
fastest layout found. Every formulation is tried with the scan unrolled once and four times, on one
device and sharded over two (both cores), and the fastest is taken.

- ``linear``: the exact sampled plant.
- ``substeps``: ticks in which no variant switches take one exact step (``lax.cond``); in the others
  every variant takes fixed substeps, as many as bring the loads within 0.1 um of the event-located
  ones. It works for any plant.
- ``closed form``: ticks with a switch are solved by the formulas of this very plant, one rigid body
  on one motor: at constant torque until the supply no longer limits, or the time of the stop by a
  logarithm, and an exponential for what is left of the tick. It works for no other plant.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm

from benchmarks._twin_cases import (
    BATCH_TICKS,
    BREAK,
    COUNTS,
    GAIN,
    KE,
    KT,
    LIMIT,
    SLIDE,
    VARIANTS,
    VOLT,
    H,
    R,
    inertias,
    rows_of,
)

# Two devices on the processor, so that JAX can use both cores; read when jax is imported.
os.environ.setdefault("XLA_FLAGS", "--xla_force_host_platform_device_count=2")
INNER_UNROLL = 4


class Formulation(NamedTuple):
    """One way to write the batch.

    ``run(unroll, devices)`` gives a function without arguments; ``loads`` gives (ticks, variants /
    100) loads in m without quantisers.
    """

    name: str
    run: Callable[[int, int], Callable[[], Any]]
    loads: Callable[[int], np.ndarray]


def tables(case: str, substeps: int) -> np.ndarray:
    """Return (modes, 2, 4, V): the step of each mode; columns angle, speed, volts, 1."""
    constants = {"linear-quantised": (0.0,), "saturated": (0.0, LIMIT, -LIMIT),
                 "contact": (0.0, SLIDE, -SLIDE)}[case]  # fmt: skip
    found = np.zeros((len(constants), 2, 4, VARIANTS))
    for m, constant in enumerate(constants):
        for v, inertia in enumerate(inertias()):
            Z = np.zeros((4, 4))
            Z[0, 1] = 1.0
            if case == "saturated" and m:
                Z[1, 3] = KT * constant / inertia
            else:
                Z[1] = 0.0, -KT * KE / (R * inertia), KT / (R * inertia), -constant / inertia
            found[m, :, :, v] = expm(Z * H / substeps)[:2]
    return found


def formulations(case: str, substeps: int) -> list[Formulation]:  # noqa: PLR0915
    """Return the ways to write a case; raises ImportError where JAX is missing."""
    import jax
    import jax.numpy as jnp
    from jax import lax
    from jax.sharding import Mesh, NamedSharding
    from jax.sharding import PartitionSpec as Spec

    jax.config.update("jax_enable_x64", True)
    whole, fine = tables(case, 1), tables(case, substeps)
    decay = KT * KE / (R * inertias())
    push = KT * LIMIT / inertias()

    def linear(P: Any, m: int, x: Any, u: Any) -> tuple[Any, Any]:
        theta, omega = x
        a = theta + P[m, 0, 1] * omega + P[m, 0, 2] * u
        b = P[m, 1, 1] * omega + P[m, 1, 2] * u
        return (a, b) if case == "linear-quantised" else (a + P[m, 0, 3], b + P[m, 1, 3])

    def way_of(omega: Any, u: Any) -> Any:
        torque = KT * u / R
        way = jnp.where(abs(torque) > BREAK, jnp.sign(torque), 0.0)
        return jnp.where(omega != 0, jnp.sign(omega), way)

    def repeated(step: Callable[[Any, Any], Any], x: Any, u: Any) -> Any:
        unroll = min(INNER_UNROLL, substeps)
        return lax.fori_loop(0, substeps, lambda _, y: step(y, u), x, unroll=unroll)

    def exact(p: Any, x: Any, u: Any) -> Any:
        return linear(p["whole"], 0, x, u)

    def clipped(p: Any, x: Any, u: Any) -> Any:
        current = (u - KE * x[1]) / R
        high, low = current > LIMIT, current < -LIMIT
        free, up, down = (linear(p["fine"], m, x, u) for m in range(3))
        return tuple(jnp.where(high, up[i], jnp.where(low, down[i], free[i])) for i in range(2))

    def sliding(P: Any, x: Any, u: Any, way: Any) -> Any:
        forth, back = linear(P, 1, x, u), linear(P, 2, x, u)
        moved = [jnp.where(way > 0, forth[i], back[i]) for i in range(2)]
        return jnp.where(way == 0, x[0], moved[0]), jnp.where(way == 0, 0.0, moved[1])

    def slipping(p: Any, x: Any, u: Any) -> Any:
        way = way_of(x[1], u)
        theta, omega = sliding(p["fine"], x, u, way)
        return theta, jnp.where(omega * way < 0, 0.0, omega)

    def supply(p: Any, x: Any, u: Any, slow: Callable[..., Any]) -> Any:
        # Under constant volts the current only falls: it is limited at the start or not at all.
        limited = jnp.any(abs(u - KE * x[1]) > LIMIT * R)
        return lax.cond(limited, slow, lambda p, x, u: linear(p["whole"], 0, x, u), p, x, u)

    def friction(p: Any, x: Any, u: Any, slow: Callable[..., Any]) -> Any:
        way = way_of(x[1], u)
        moved = sliding(p["whole"], x, u, way)
        return lax.cond(jnp.any(moved[1] * way < 0), slow, lambda *_: moved, p, x, u)

    def supply_closed(p: Any, x: Any, u: Any) -> Any:
        theta, omega = x
        current = (u - KE * omega) / R
        sign = jnp.where(current > LIMIT, 1.0, jnp.where(current < -LIMIT, -1.0, 0.0))
        gain = sign * p["push"]
        until = ((u - sign * LIMIT * R) / KE - omega) / jnp.where(sign == 0, 1.0, gain)
        until = jnp.where(sign == 0, 0.0, jnp.clip(until, 0.0, H))
        theta = theta + omega * until + 0.5 * gain * until * until
        omega, left, end = omega + gain * until, H - until, u / KE
        E = jnp.exp(-p["decay"] * left)
        return theta + end * left + (omega - end) * (1 - E) / p["decay"], end + (omega - end) * E

    def leg(p: Any, x: Any, u: Any, way: Any, left: Any) -> Any:
        theta, omega = x
        end = (u - way * SLIDE * R / KT) / KE
        ratio = end / (end - omega)
        crosses = (ratio > 0) & (ratio < 1)
        stop = -jnp.log(jnp.where(crosses, ratio, 0.5)) / p["decay"]
        until = jnp.where(crosses & (way != 0), jnp.minimum(stop, left), left)
        E = jnp.exp(-p["decay"] * until)
        moved = theta + end * until + (omega - end) * (1 - E) / p["decay"]
        speed = jnp.where(until < left, 0.0, end + (omega - end) * E)
        return (jnp.where(way == 0, theta, moved), jnp.where(way == 0, 0.0, speed)), left - until

    def friction_closed(p: Any, x: Any, u: Any) -> Any:
        x, left = leg(p, x, u, way_of(x[1], u), H)
        return leg(p, x, u, way_of(x[1], u), left)[0]

    def scan(advance: Callable[..., Any], quantised: bool, unroll: int, refs: Any, p: Any) -> Any:
        def tick(carry: Any, reference: Any) -> Any:
            x, before, last, worst = carry
            read = x[0] * COUNTS
            read = jnp.floor(read + 0.5) if quantised else read
            error = reference - read
            level = 2 * error + 4 * (error - before)
            level = jnp.clip(jnp.round(level) if quantised else level, -2048, 2047)
            if quantised:
                level = jnp.where(level * last < 0, 0.0, level)
            after = advance(p, x, level * (VOLT * GAIN))
            kept = None if quantised else x[0][::100]
            return (after, error, level, jnp.maximum(worst, abs(error))), kept

        zero = jnp.zeros(p["decay"].shape[-1])
        return lax.scan(tick, ((zero, zero), zero, zero, zero), refs, unroll=unroll)

    rows = rows_of(case, BATCH_TICKS)
    references = jnp.asarray(np.concatenate(([0], np.cumsum(rows)))[:-1].astype(float))
    numbers = {"whole": whole, "fine": fine, "decay": decay, "push": push}

    def formulation(name: str, advance: Callable[..., Any], names: tuple[str, ...]) -> Formulation:
        given = {n: numbers[n] for n in (*names, "decay")}

        def run(unroll: int, devices: int) -> Callable[[], Any]:
            mesh = Mesh(np.array(jax.devices()[:devices]), ("v",))
            spec = {n: Spec(*[None] * (a.ndim - 1), "v") for n, a in given.items()}
            p = {n: jax.device_put(a, NamedSharding(mesh, spec[n])) for n, a in given.items()}
            work = partial(scan, advance, True, unroll)
            if devices > 1:
                carry = ((Spec("v"), Spec("v")), Spec("v"), Spec("v"), Spec("v"))
                work = jax.shard_map(
                    work, mesh=mesh, in_specs=(Spec(), spec), out_specs=(carry, None),
                    check_vma=False,
                )  # fmt: skip
            jitted = jax.jit(work)
            return lambda: jax.block_until_ready(jitted(references, p))

        def loads(ticks: int) -> np.ndarray:
            smooth = jax.jit(partial(scan, advance, False, 1))
            p = {n: jnp.asarray(a) for n, a in given.items()}
            return np.asarray(smooth(references[:ticks], p)[1]) * COUNTS / 55.358e3

        return Formulation(name, run, loads)

    if case == "linear-quantised":
        return [formulation("linear", exact, ("whole",))]
    guard, step, closed = {
        "saturated": (supply, clipped, supply_closed),
        "contact": (friction, slipping, friction_closed),
    }[case]
    return [
        formulation(
            "substeps",
            lambda p, x, u: guard(p, x, u, lambda p, x, u: repeated(partial(step, p), x, u)),
            ("whole", "fine"),
        ),
        formulation("closed form", lambda p, x, u: guard(p, x, u, closed), ("whole", "push")),
    ]
