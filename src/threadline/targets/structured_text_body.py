"""The body of the block: watchdog, inputs, transitions in order, outputs as sums of places."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from threadline.targets.plc_net import NetPlace, PetriNet


@dataclass(frozen=True, slots=True, kw_only=True)
class Words:
    """What things are called in the program, and its two times.

    Parameters
    ----------
    inputs, outputs
        Name in the machine file to name in the program.
    clear
        Inputs that all must be true while the machine moves.
    start
        Input whose rising edge starts the cycle.
    watchdog_ms
        A scan that comes later than this after the one before is a fault.
    early_ms
        A transition fires in the scan nearest to its time: half a scan before it already.
    """

    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    clear: tuple[str, ...]
    start: str
    watchdog_ms: int
    early_ms: int


def body_lines(net: PetriNet, words: Words) -> Iterator[str]:
    """Yield the lines of the body."""
    yield from _watchdog(words)
    yield from _guards(words)
    yield from _clock(words)
    yield "(* The transitions, in order: several may fire in one scan. *)"
    step = None
    for place in net.places:
        if place.step != step:
            step = place.step
            yield f"(* Step {step} *)"
        yield from _transition(place, words, last=place is net.places[-1])
    yield ""
    yield "(* The outputs: on in the places that are named, off in every other one. *)"
    for name, word in words.outputs.items():
        yield from _output(word, [p.number for p in net.places if name in p.on])
    yield "busy := place > 0;"


def _watchdog(words: Words) -> Iterator[str]:
    limit = f"PT := T#{words.watchdog_ms}ms"
    yield "(* The watchdog: Q tells that the scan before this one is too long ago. *)"
    yield f"scan_timer(IN := TRUE, {limit});"
    yield "late := scan_timer.Q;"
    yield f"scan_timer(IN := FALSE, {limit});"
    yield f"scan_timer(IN := TRUE, {limit});"
    yield ""


def _guards(words: Words) -> Iterator[str]:
    yield "(* Whatever forbids motion takes the token away: place 0 has every output off. *)"
    yield f"allowed := {' AND '.join(words.clear)} AND NOT late;"
    yield "IF (place > 0) AND NOT allowed THEN"
    yield "  place := 0;"
    yield "  stopped := TRUE;"
    yield "  fault := late;"
    yield "END_IF;"
    yield f"IF {words.start} AND NOT start_before AND allowed AND (place = 0) THEN"
    yield "  place := 1;"
    yield "  origin := T#0ms;"
    yield "  finished := FALSE;"
    yield "  stopped := FALSE;"
    yield "  fault := FALSE;"
    yield "  cycle_timer(IN := FALSE, PT := T#24h);"
    yield "END_IF;"
    yield f"start_before := {words.start};"
    yield ""


def _clock(words: Words) -> Iterator[str]:
    early = f" + T#{words.early_ms}ms" if words.early_ms else ""
    yield "(* Milliseconds since the last input, by half a scan ahead: the nearest scan acts. *)"
    yield "cycle_timer(IN := place > 0, PT := T#24h);"
    yield f"elapsed := cycle_timer.ET - origin{early};"
    yield ""


def _transition(place: NetPlace, words: Words, *, last: bool) -> Iterator[str]:
    to = 0 if last else place.number + 1
    if place.wait is None:
        yield f"IF (place = {place.number}) AND (elapsed >= T#{place.due_ms}ms) THEN"
        yield f"  place := {to};"
        if last:
            yield "  finished := TRUE;"
        yield "END_IF;"
        return
    name, value = place.wait
    word = words.inputs[name]
    yield f"IF place = {place.number} THEN"
    yield f"  IF {word if value else f'NOT {word}'} THEN"
    yield f"    place := {to};"
    if last:
        yield "    finished := TRUE;"
    yield "    origin := cycle_timer.ET;"
    yield f"    elapsed := T#{words.early_ms}ms;"
    yield f"  ELSIF elapsed >= T#{place.due_ms}ms THEN"
    yield "    place := 0;"
    yield "    stopped := TRUE;"
    yield "    fault := TRUE;"
    yield "  END_IF;"
    yield "END_IF;"


def _output(word: str, places: list[int]) -> Iterator[str]:
    runs: list[tuple[int, int]] = []
    for number in places:
        if runs and runs[-1][1] == number - 1:
            runs[-1] = (runs[-1][0], number)
        else:
            runs.append((number, number))
    terms = [
        f"(place = {a})" if a == b else f"((place >= {a}) AND (place <= {b}))" for a, b in runs
    ]
    if not terms:
        yield f"{word} := FALSE;"
        return
    yield f"{word} := {terms[0]}{';' if len(terms) == 1 else ''}"
    for term in terms[1:]:
        yield f"  OR {term}{';' if term is terms[-1] else ''}"
