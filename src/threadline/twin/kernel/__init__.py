"""The engine of the twin, behind one door: what writes machine code, runs it, and owns its memory.

The rest of the package imports from here and from nowhere deeper:

- ``Engine``: a machine, or many variants of it, ready to be run.
- ``Run``: one run of an engine; rows in, samples out, its state kept between.
- ``Reading``, ``Signal``: what can be sampled; ``Measures``: what is kept at every tick.
- ``Snapshot``: all that a run has changed so far, to go on in another process.

Inside, data flows like this: ``piece`` (equations, instants and tables of one connected piece),
``shape`` (what its code is written for), ``layout`` (where each number lies), ``run`` (the code,
with ``tick``, ``profile``, ``events``, ``exits``), ``state`` (the workspace and the calls).
``docs/twin-kernel.md`` shows all of it at work.
"""

from threadline.twin.kernel.engine import NEVER, Engine, Measures, Reading, Run, Signal
from threadline.twin.kernel.state import Snapshot

__all__ = ["NEVER", "Engine", "Measures", "Reading", "Run", "Signal", "Snapshot"]
