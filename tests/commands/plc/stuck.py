"""Every contact stuck, at every place of the cycle: the program's faults, and forbidden outputs.

``python -m tests.commands.plc.stuck`` prints the table of the documents.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from tests.commands.plc.driving import Bench, homed
from tests.commands.plc.pistons import Cell
from tests.commands.plc.texts import controller

CONTACTS = ("x_is_left", "x_is_right", "z_is_up", "z_is_down", "letter_held")


@dataclass(frozen=True)
class Stuck:
    step: str
    place: int
    contact: str
    value: bool
    code: int
    text: str
    named: str
    stopped_in: str
    finished: bool


def forbidden(on: set[str], cell: Cell) -> str:
    """Return the outputs that must not be on at the pistons' true places; empty if all is well."""
    x, z = cell.pistons["x"].at, cell.pistons["z"].at
    if {"x_left", "x_right"} <= on or {"z_up", "z_down"} <= on:
        return "both ways at once"
    if on & {"x_left", "x_right"} and z > 6.0:
        return f"X moves with the lift at {z:.0f} mm"
    if "knife" in on and (z < 94.0 or x > 6.0):
        return f"the knife at X {x:.0f} mm, Z {z:.0f} mm"
    if "press" in on and (z < 94.0 or x < 194.0):
        return f"the press at X {x:.0f} mm, Z {z:.0f} mm"
    if on and "main_air" not in on:
        return "something is on without air"
    return ""


def watched(bench: Bench) -> str:
    """Run to the end; return the step in which it stopped. Raises if an output is wrongly on."""
    step = ""
    while bench.block["busy"]:
        step = bench.block["step_text"]
        on = bench.scan()
        wrong = forbidden(on, bench.cell)
        assert not wrong, (wrong, bench.cell.stuck, step)
        if bench.block["fault"]:
            assert on == set(), "outputs are off in the scan of the fault"
    if not bench.block["finished"]:
        assert bench.press("start_button") == set(), "not before it was acknowledged"
    return step


def every_place(jitter: float = 0.2, seed: int = 2) -> Iterator[Bench]:
    """Yield the bench at the first scan of every place of one cycle."""
    bench = homed(controller("letter-placer", "none"), 10_000, jitter, seed)
    bench.press("start_button")
    place = 0
    while bench.block["busy"]:
        if bench.block["place"] != place:
            place = bench.block["place"]
            yield bench
        bench.scan()
    assert bench.block["finished"]


def every_case() -> Iterator[Stuck]:
    for bench in every_place():
        for contact in CONTACTS:
            for value in (False, True):
                trial = bench.fork()
                step, place = trial.block["step_text"], trial.block["place"]
                trial.cell.stuck = {contact: value}
                last = watched(trial)
                b = trial.block
                yield Stuck(
                    step, place, contact, value, b["fault_code"], b["fault_text"],
                    b["contact_text"], last, b["finished"],
                )  # fmt: skip


def main() -> None:
    rows: dict[tuple[str, str], dict[str, list[str]]] = {}
    for case in every_case():
        key = case.contact, "on" if case.value else "off"
        line = "cycle ends" if case.finished else f"{case.text} ({case.stopped_in}"
        line += "" if case.finished else f", {case.named})"
        steps = rows.setdefault(key, {}).setdefault(line, [])
        if case.step not in steps:
            steps.append(case.step)
    print("| stuck | from step | what the program tells (where it stops, contact) |")
    print("|---|---|---|")
    for (contact, value), line in rows.items():
        for text, steps in line.items():
            print(f"| {contact} {value} | {', '.join(steps)} | {text} |")


if __name__ == "__main__":
    main()
