"""How a long calculation tells how far it has come.

Whoever draws a bar of it needs no more than this name.
"""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction that is done."""
