"""What the kernels share: keeping compilation short."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import intrinsic


def _stays_apart(_typing_context: Any, small: Any) -> Any:
    literal = types.unliteral(small)  # type: ignore[no-untyped-call]
    short = bool(getattr(small, "literal_value", True))

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        if short:
            builder.function.attributes.add("optsize")
        return context.get_dummy_value()

    return types.void(literal), generate


stays_apart: Callable[[bool], None] = intrinsic(_stays_apart)  # type: ignore[assignment]
"""Called first thing in a kernel, keeps LLVM from copying it into its callers (and,
if small, from unrolling it).

Without it the rare paths (a mode met for the first time, an advance with events) would be
optimised anew in every kernel, several times over: minutes instead of seconds.
"""
