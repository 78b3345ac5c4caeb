"""Faults that can be injected into the simulated machine, for tests of the guards."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import OptionError
from threadline.foreign_messages import nearest
from threadline.machine import Machine
from threadline.typed_number import parse_number

OF_AXES = ("stuck-encoder", "encoder-jump", "unheeded-reversal")
OF_GRIDS = ("light-grid",)
OF_ALL = ("e-stop", "late-ticks", "one-late-tick", "lost-link", "power-loss")
KINDS = (*OF_AXES, "switch-hit", "stuck-contact", *OF_GRIDS, *OF_ALL)
_JUMP_COUNTS = 20_000.0
_LATEST_S = 1e9
_FORM = re.compile(r"([a-z-]+)(?::([A-Za-z_0-9]+))?@(.+)")


@dataclass(frozen=True, slots=True)
class SimFault:
    """A fault that begins at a tick of the run.

    Parameters
    ----------
    kind
        One of ``KINDS``. Faults of encoders, reversals, switches and contacts change the reports to
        the executor alone; the simulated controllers keep their true readings. A broken light grid
        is one for the controller, too. After a lost link the machine
        plays the rows that it holds; without power it plays and reports nothing.
    tick
        Tick at which the fault begins.
    where
        Name of the axis, switch or contact; empty for a fault of none.
    """

    kind: str
    tick: int
    where: str = ""

    def told(
        self, at: int, samples: dict[str, FloatArray], machine: Machine, stuck: dict[str, float]
    ) -> None:
        """Change the samples of a report from number ``at`` on, in place.

        Parameters
        ----------
        at
            0 where the fault began before them.
        samples
            (n,) samples of each channel.
        machine
            The machine, for the scale of an encoder.
        stuck
            Reading of each stuck encoder or contact; it is added when that sticks.
        """
        name = next(iter(samples), "")
        if not name or at >= len(samples[name]):
            return
        if self.kind == "stuck-encoder":
            values = samples[f"{self.where}.measured"]
            values[at:] = stuck.setdefault(self.where, float(values[at]))
        elif self.kind == "stuck-contact":
            samples[self.where][at:] = stuck.setdefault(self.where, samples[self.where][at])
        elif self.kind == "switch-hit":
            samples[self.where][at:] = 1.0
        elif self.kind == "encoder-jump":
            scale = machine.axes[self.where].counts.si
            samples[f"{self.where}.measured"][at:] += _JUMP_COUNTS / scale
        elif self.kind == "unheeded-reversal":
            samples[f"{self.where}.voltage"][at:] = np.resize([1.0, -1.0], len(samples[name]) - at)

    @property
    def cuts_supply(self) -> bool:
        """Whether it takes the supply of the drives away."""
        return self.kind in {"e-stop", "power-loss"}

    def silences(self, tick: int) -> bool:
        """Return whether the machine sends no more messages from ``tick`` on."""
        return self.kind in {"lost-link", "power-loss"} and tick >= self.tick

    def stops(self, tick: int) -> bool:
        """Return whether the emergency stop is pressed at ``tick``; it stays so."""
        return self.kind == "e-stop" and tick >= self.tick

    def late(self, tick: int) -> float:
        """Return the lateness of the report that begins at ``tick``, in periods of a report."""
        if tick < self.tick:
            return 0.0
        if self.kind == "late-ticks":
            return 0.8
        return 6.0 if self.kind == "one-late-tick" else 0.0


def _places(machine: Machine) -> dict[str, list[str]]:
    """Return what could have each kind of fault; faults of the whole machine are left out."""
    looped = [] if machine.told_positions else list(machine.axes)
    contacts = machine.contacts.items()
    return {
        **dict.fromkeys(OF_AXES, looped),
        "switch-hit": list(machine.inputs),
        "stuck-contact": [name for name, contact in contacts if contact.cylinder],
        **{k: [n for n, contact in contacts if contact.kind == k] for k in OF_GRIDS},
    }


def parse_fault(text: str, machine: Machine) -> SimFault:
    """Return the fault that a text like ``"stuck-encoder:X@1.2 s"`` describes.

    Raises
    ------
    OptionError
        If there is no such fault, axis, switch or time.
    """
    form = _FORM.fullmatch(text.strip())
    if form is None:
        raise OptionError(
            f"--inject {text[:40]!r} is no fault", remedy='Write it like "stuck-encoder:X@1.2 s".'
        )
    kind, where, when = form.groups()
    if kind not in KINDS:
        raise OptionError(f"there is no fault {kind[:40]!r}", remedy=nearest(kind, KINDS))
    places = _places(machine)
    known = places.get(kind)
    if known is not None and not known:
        raise OptionError(
            f"--inject {kind}: {machine.name} has nothing that could fail so",
            remedy=f"Use one of {', '.join([k for k in KINDS if places.get(k, True)])}.",
        )
    if known is not None and kind not in OF_GRIDS and where is None:
        raise OptionError(
            f"--inject {kind} does not say where",
            remedy=f'Write "{kind}:{known[0]}@1.2 s"; {machine.name} has {", ".join(known)}.',
        )
    if known is not None and kind not in OF_GRIDS and where not in known:
        raise OptionError(
            f"--inject {kind}: {machine.name} has no {where[:40]!r}",
            remedy=f"It has {', '.join(known)}.",
        )
    if where and (known is None or kind in OF_GRIDS):
        raise OptionError(f"--inject {kind} is of no axis", remedy=f'Write "{kind}@1.2 s".')
    time_s = parse_number("--inject", when.strip(), "s", "1.2 s")
    if not 0.0 <= time_s <= _LATEST_S:
        raise OptionError(
            f"--inject {kind}: {when.strip()[:40]!r} is no time of a run",
            remedy=f"Give one from 0 s to {_LATEST_S:g} s.",
        )
    return SimFault(kind, round(time_s / float(machine.command_clock.period_s)), where or "")
