"""Words that the Tab key completes: library machines, targets, and the values of options.

A shell that gets no word from here completes names of files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from threadline.errors import ThreadlineError


def machines(incomplete: str) -> list[str]:
    """Return the library machines that begin so; after a plus, the machine with its overlays."""
    # Machines take a while to load, and --help does not need them.
    from threadline.machine import library_names, overlay_names

    name, plus, _ = incomplete.rpartition("+")
    if not plus:
        return beginning(library_names(), incomplete)
    try:
        return beginning((f"{name}+{overlay}" for overlay in overlay_names(name)), incomplete)
    except (ThreadlineError, OSError):  # there is no such machine to name overlays of
        return []


def targets(incomplete: str) -> list[str]:
    """Return the targets of all kinds of work that begin so."""
    from threadline.proof.kinds import KINDS  # the kinds import the planners

    return beginning((name for kind in KINDS.values() for name in kind.targets), incomplete)


def each_target(incomplete: str) -> list[str]:
    """Return a list of targets, separated by commas, with its last one completed."""
    return last_of(targets)(incomplete)


def one_of(values: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return a function that completes one of the values that ``values`` returns."""

    def complete(incomplete: str) -> list[str]:
        return beginning(values(), incomplete)

    return complete


def last_of(complete: Callable[[str], list[str]]) -> Callable[[str], list[str]]:
    """Return a function that completes the last word of a list, separated by commas."""

    def completed(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        return [f"{before}{comma}{word}" for word in complete(last)]

    return completed


def beginning(words: Iterable[str], incomplete: str) -> list[str]:
    """Return the words that begin so, each once."""
    return [word for word in dict.fromkeys(words) if word.startswith(incomplete)]
