"""Linear models: state space with a dead time at every input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, Locked, read_only
from threadline.errors import OptionError


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateSpace(Locked):
    """``x' = A x + B u(t - delay)``, ``y = C x + D u(t - delay)``, SI throughout.

    Parameters
    ----------
    A
        (n, n).
    B
        (n, inputs).
    C
        (outputs, n).
    D
        (outputs, inputs).
    delay_s
        (inputs,) dead time between the command of an input and its effect, in s.
    states, inputs, outputs
        Names, in the order of the rows and columns.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    delay_s: FloatArray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("A", "B", "C", "D"):
            object.__setattr__(self, name, read_only(getattr(self, name), name, ndim=2))
        object.__setattr__(self, "delay_s", read_only(self.delay_s, "delay_s", ndim=1))
        n, m, p = len(self.states), len(self.inputs), len(self.outputs)
        for name, wanted in (
            ("A", (n, n)),
            ("B", (n, m)),
            ("C", (p, n)),
            ("D", (p, m)),
            ("delay_s", (m,)),
        ):
            found = getattr(self, name).shape
            if found != wanted:
                raise ValueError(f"{name} has shape {found}, expected {wanted}")
        if (self.delay_s < 0).any():
            raise ValueError(f"delay_s must not be negative, got {self.delay_s.tolist()}")

    def poles(self) -> NDArray[np.complex128]:
        """Return the (n,) eigenvalues of A in rad/s."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)

    def select(self, inputs: list[str], outputs: list[str]) -> StateSpace:
        """Return the same states seen from some inputs and outputs only.

        Raises
        ------
        OptionError
            If one of them does not exist.
        """
        columns = [_index(name, self.inputs, "input") for name in inputs]
        rows = [_index(name, self.outputs, "output") for name in outputs]
        return StateSpace(
            A=self.A,
            B=self.B[:, columns],
            C=self.C[rows],
            D=self.D[np.ix_(rows, columns)],
            delay_s=self.delay_s[columns],
            states=self.states,
            inputs=tuple(inputs),
            outputs=tuple(outputs),
        )

    def response(self, omega_rad_s: FloatArray) -> NDArray[np.complex128]:
        """Return the (k, outputs, inputs) frequency response, dead time exact.

        Parameters
        ----------
        omega_rad_s
            (k,) frequencies; none may be a pole on the imaginary axis.
        """
        s = 1j * np.asarray(omega_rad_s, dtype=np.float64)
        resolvent = s[:, None, None] * np.eye(len(self.A)) - self.A
        inner = np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(s), *self.B.shape)))
        delay = np.exp(-s[:, None] * self.delay_s)
        return np.asarray((self.C @ inner + self.D) * delay[:, None, :], dtype=np.complex128)


def _index(name: str, among: tuple[str, ...], what: str) -> int:
    if name not in among:
        raise OptionError(f"no {what} {name!r}", remedy=f"There are: {', '.join(among)}.")
    return among.index(name)
