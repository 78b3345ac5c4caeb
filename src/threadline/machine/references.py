"""Names in a machine file that stand for another of its tables."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def check_known(names: Iterable[str], among: Iterable[str], where: str, what: str) -> None:
    """Check that what a key names exists.

    Parameters
    ----------
    names, among
        Those that the key gives; those that there are.
    where, what
        The key; what it names, for people.

    Raises
    ------
    ValueError
        With the first name that is none of ``among``.
    """
    known = list(among)
    for name in names:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"there are: {', '.join(known)}."
            raise ValueError(f"{where} names the {what} {name!r}, which does not exist; {hint}")
