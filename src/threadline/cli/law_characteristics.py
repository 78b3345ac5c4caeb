"""Cv, Ca, Cj and the efficiency of a motion law, as a row of a table and as JSON content."""

from __future__ import annotations

from typing import Any

from threadline.motion.laws import Law


def law_row(law: Law) -> list[str]:
    """Return the characteristics of a law as a row of a table."""
    return [
        law.name,
        f"{law.velocity:.4f}",
        f"{law.acceleration:.4f}",
        "infinite" if law.jerk is None else f"{law.jerk:.4f}",
        f"{law.efficiency:.4f}",
    ]


def law_json(law: Law) -> dict[str, Any]:
    """Return the characteristics of a law as JSON content; an infinite Cj is None."""
    return {
        "name": law.name,
        "Cv": law.velocity,
        "Ca": law.acceleration,
        "Cj": law.jerk,
        "efficiency": law.efficiency,
    }
