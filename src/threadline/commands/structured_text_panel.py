"""The part of a function block's body for people: work by hand, and texts for a panel.

A jog input held while work by hand begins, or while a fault is acknowledged, is not a fresh press.
A jog that has stopped, at its end or because a needed switch went off, stays stopped until the next
press.
"""

from __future__ import annotations

from collections.abc import Iterator

from threadline.commands.plc_sequence import FAULTS, Sequence, Variable, Words
from threadline.machine import Machine

HAND_NAMES = (
    "jogging", "hand_before", "hand_ready", "jog_before", "jog_asked", "jog_runs", "hand_timer",
    "rest_timer", "t_hand_air", "t_hand_rest",
)  # fmt: skip


def hand_constants(words: Words) -> Iterator[Variable]:
    """Yield the two times for work by hand."""
    for name, ms, note in (
        ("t_hand_air", words.air_ms, "by hand: the air is up"),
        ("t_hand_rest", words.dwell_ms, "by hand: the valves rest between two things"),
    ):
        yield Variable(name=name, type="TIME", initial=f"T#{ms}ms", note=note)


def hand_state() -> Iterator[Variable]:
    """Yield the variables that the lines of ``hand_lines`` keep from scan to scan."""
    for name in ("jogging", "hand_before", "hand_ready", "jog_runs"):
        yield Variable(name=name, type="BOOL", initial="FALSE")
    for name in ("jog_before", "jog_asked"):
        yield Variable(name=name, type="INT", initial="0")
    for name in ("hand_timer", "rest_timer"):
        yield Variable(name=name, type="TON", derived=True)


def hand_lines(sequence: Sequence, words: Words) -> Iterator[str]:
    """Yield the part of the body for work by hand."""
    yield "(* By hand: one thing at a time, slowly, where the cycle would do it. A change of jog *)"
    yield "(* asks for it; what is held when the work by hand begins asks for nothing. *)"
    yield f"jogging := manual AND allowed AND NOT fault AND (place = {sequence.idle});"
    yield "IF NOT jogging OR NOT hand_before THEN"
    yield "  jog_asked := 0;"
    yield "  jog_runs := FALSE;"
    yield "ELSIF jog <> jog_before THEN"
    yield "  jog_asked := jog;"
    yield "  jog_runs := FALSE;"
    yield "END_IF;"
    yield "jog_before := jog;"
    yield "hand_before := jogging;"
    yield "(* First the air is up; then the valves rest between two things as long as they must. *)"
    yield "hand_timer(IN := jogging, PT := t_hand_air);"
    yield "rest_timer(IN := NOT jog_runs, PT := t_hand_rest);"
    yield "hand_ready := hand_timer.Q AND (jog_runs OR rest_timer.Q);"
    yield "jog_runs := FALSE;"
    yield "IF jogging THEN"
    yield "  homed := FALSE;"
    yield "  step_text := 'by hand';"
    for name in sequence.air:
        yield f"  {words.outputs[name]} := TRUE;"
    yield "END_IF;"
    for jog in sequence.jogs:
        needs = [_reads(contact, words) for contact in jog.needs]
        where = [" AND ".join(_reads(c, words) for c in one) for one in jog.where]
        if where:
            needs.append(f"({' OR '.join(f'({one})' for one in where)})")
        yield f"IF hand_ready AND (jog_asked = {jog.name}) THEN"
        on = [f"{words.outputs[name]} := TRUE;" for name in jog.on] + ["jog_runs := TRUE;"]
        if needs:
            yield f"  IF {' AND '.join(needs)} THEN"
            yield from (f"    {line}" for line in on)
            yield "  ELSE"
            yield "    jog_asked := 0;"
            yield "  END_IF;"
        else:
            yield from (f"  {line}" for line in on)
        yield "END_IF;"
    yield ""


def _reads(contact: tuple[str, bool], words: Words) -> str:
    name, value = contact
    return words.inputs[name] if value else f"NOT {words.inputs[name]}"


def panel_texts(sequence: Sequence, words: Words, machine: Machine) -> Iterator[str]:
    """Yield the texts of faults, contacts and hints."""
    yield "(* Words for a panel. *)"
    for name, text in FAULTS.items():
        yield f"IF fault_code = {name} THEN"
        yield f"  fault_text := '{text}';"
        yield "END_IF;"
    yield "contact_text := '';"
    yield "contact_address := '';"
    for contact, name in sequence.contacts.items():
        yield f"IF fault_contact = {name} THEN"
        yield f"  contact_text := '{plain_text(contact)}';"
        yield f"  contact_address := '{machine.contacts[contact].address}';"
        yield "END_IF;"
    yield ""
    yield "(* Why nothing happens, and the next action. *)"
    yield "hint_text := '';"
    yield f"IF place = {sequence.idle} THEN"
    hints = (
        *((f"NOT {name}", "the light grid is broken") for name in words.grids),
        *((f"NOT {name}", "the enable is missing") for name in words.enables),
        ("fault", "acknowledge first"),
        ("manual AND NOT hand_timer.Q", "the air is coming up"),
        ("jog_runs", ""),
        ("manual AND (jog_asked <> 0) AND NOT hand_ready", "the valves rest"),
        ("manual AND (jog <> 0)", "not here, at its end, or held too long: let go of it"),
        ("manual", "choose a jog"),
        ("NOT homed", "home first"),
    )
    for number, (condition, text) in enumerate(hints):
        yield f"  {'ELSIF' if number else 'IF'} {condition} THEN"
        yield f"    hint_text := '{text}';"
    yield "  ELSE"
    yield "    hint_text := 'ready to start';"
    yield "  END_IF;"
    yield "END_IF;"
    yield ""


def plain_text(text: str) -> str:
    """Return text as characters that a string literal of every PLC takes."""
    kept = (c if c.isascii() and (c.isalnum() or c in " _-.,") else " " for c in text[:60])
    return "".join(kept).strip()
