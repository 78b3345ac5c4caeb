"""What the kernels share: keeping compilation short."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import intrinsic


def _stays_apart(_typing_context: Any) -> Any:
    """Keep LLVM from copying the calling function into its callers, and from unrolling it.

    Without it the rare paths (a mode met for the first time, an advance with events) would be
    optimised anew in every kernel, several times over: minutes instead of seconds.
    """

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        builder.function.attributes.add("optsize")
        return context.get_dummy_value()

    return types.void(), generate


stays_apart: Callable[[], None] = intrinsic(_stays_apart)  # type: ignore[assignment]
"""Called first thing in a kernel."""
