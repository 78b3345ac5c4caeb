"""The engine of the twin: it writes machine code, runs it, and owns its memory.

Other rooms import only these names:

- ``Engine``: a machine, or many variants of it, ready to run.
- ``Run``: one run of an engine; rows in, samples out, with its state in between.
- ``Reading``, ``Signal``: quantities to sample; ``Measures``: extremes over all ticks.
- ``Snapshot``: the state of a run, to continue in another process.

Inside, data flows like this: ``piece`` (equations, instants and tables of one connected piece),
``shape`` (the structure that determines the code), ``layout`` (the place of each number), ``run``
(the code, with ``tick``, ``sensing``, ``mode_changes``, ``exits``), ``state`` (the
workspace and the calls). ``docs/twin-kernel.md`` explains it with an example.
"""

from threadline.twin.kernel.engine import NEVER, Engine, Measures, Reading, Run, Signal
from threadline.twin.kernel.state import Snapshot

__all__ = ["NEVER", "Engine", "Measures", "Reading", "Run", "Signal", "Snapshot"]
