"""Machines with any axes, each moved by its own stepper, without loads."""

from __future__ import annotations

from pathlib import Path

from threadline.machine import Machine, load_machine

_HEAD = """name = "made"
title = "made for tests"
sources = ["made"]
tick_budget = "1e9 tick exact, assumed"
[clocks]
pulse = "1 ms exact, assumed"
[tool]
radius = "50 mm exact, assumed"
"""
_AXIS = """[bodies.{low}]
kind = "rotary"
inertia = "3.2e-5 kg m^2 exact, assumed"
[drives.{low}]
kind = "stepper"
body = "{low}"
clock = "pulse"
full_steps = "200 count/rev exact, assumed"
microsteps = "16 exact, assumed"
curve = [
  {{ speed = "0 rad/s exact, assumed", torque = "9 N m exact, assumed" }},
  {{ speed = "5000 rad/s exact, assumed", torque = "9 N m exact, assumed" }},
]
[axes.{name}]
kind = "{kind}"
drive = "{low}"
counts = "{counts} exact, assumed"
velocity = "{velocity} exact, assumed"
acceleration = "{acceleration} exact, assumed"
endless = true
"""


def made_machine(folder: Path, linear: str, rotary: str, more: str = "") -> Machine:
    """Return a machine with these axes, all of them endless."""
    text = _HEAD
    for name in linear + rotary:
        straight = name in linear
        text += _AXIS.format(
            name=name,
            low=name.lower(),
            kind="linear" if straight else "rotary",
            counts="80 count/mm" if straight else "26.66667 count/deg",
            velocity="0.5 m/s" if straight else "3600 deg/s",
            acceleration="5 m/s^2" if straight else "200 rad/s^2",
        )
    file = folder / "made.toml"
    file.write_text(text + more)
    return load_machine(file)
