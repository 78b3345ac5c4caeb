"""Print the cost of scans and their jitter: ``python -m tests.commands.plc.scan_table``."""

from __future__ import annotations

from tests.commands.plc.test_scans import ACROSS_MS, SCAN_OF, ZV_MS, run
from tests.commands.plc.test_vibration import drive
from tests.commands.plc.texts import controller

SEEDS = range(6)
FLOWS = (0.63, 0.37)


def switching_error_ms(machine: str, period: int, jitter: float, seed: int) -> float:
    """Return the largest error of X's switchings to the right against the shaper's own times."""
    trace = run(controller(machine), period, jitter, seed)
    stroke = [(t, state) for t, state in trace if "x_right" in state]
    begin = stroke[0][0]
    end = next(t for t, state in trace if t > begin and "x_right" not in state)
    expected = (ZV_MS, ACROSS_MS, ACROSS_MS + ZV_MS)
    found = (stroke[1][0], stroke[2][0], end)
    return max(abs((t - begin) / 1000 - w) for t, w in zip(found, expected, strict=True))


def main() -> None:
    print("| scan ms | jitter | largest switching error ms | table rings um |")
    print("|---|---|---|---|")
    unshaped = drive(controller("letter-placer", "none"), 10_000, 0.0, FLOWS, 1)
    print(f"| 10 | 0 | unshaped | {unshaped:.0f} |")
    for machine, period in SCAN_OF.items():
        for jitter in (0.0, 0.2):
            seeds = SEEDS if jitter else range(1)
            errors = [switching_error_ms(machine, period, jitter, s) for s in seeds]
            left = [drive(controller(machine), period, jitter, FLOWS, s) for s in seeds]
            span = " to ".join(dict.fromkeys(f"{v:.1f}" for v in (min(left), max(left))))
            print(f"| {period / 1000:g} | {jitter:.0%} | {max(errors):.1f} | {span} |")


if __name__ == "__main__":
    main()
