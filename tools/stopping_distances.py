"""How far the simulated winder goes after its executor is gone, and after a stop.

``python -m tools.stopping_distances``: the worst over 52 instants of a run there and back, in mm of
X, for several speeds. ``docs/safety.md`` has the figures.
"""

from __future__ import annotations

import numpy as np
from tests.live.bench import Bench, table_of_counts, there_and_back, winder

from threadline.live.states import Cause


def distances(peak: float, tick: int, *, stop: bool) -> tuple[float, float]:
    """Return how far command and load of X go from an instant on, mm."""
    bench = Bench().ready()
    bench.executor.start(table_of_counts(there_and_back(peak)))
    bench.go_on(tick)
    at = bench.executor.tick
    if stop:
        bench.desk.ask(Cause.STOP)
        bench.go_on()
    else:
        bench.wire.mute = True
        bench.wire.machine.play(400)
        message = bench.wire.receive()
        assert message is not None
        bench.sink.block(bench.executor.far_end.reported(message, None))
    return tuple(  # type: ignore[return-value]
        1e3 * float(np.abs(np.diff(bench.channel(f"X.{what}")[at:])).sum())
        for what in ("commanded", "load")
    )


def main() -> None:
    """Print a line for each speed."""
    mm_s = 1e3 / winder().counts_per_unit[1] / 0.005
    for peak in (10.0, 20.0):
        for stop in (False, True):
            found = [distances(peak, tick, stop=stop) for tick in range(8, 630, 12)]
            commanded, load = np.max(found, axis=0)
            what = "stop" if stop else "lost"
            print(
                f"{peak * mm_s:6.1f} mm/s {what}: commanded {commanded:.2f} mm, load {load:.2f} mm"
            )


if __name__ == "__main__":
    main()
