"""Program units of a PLC as data: what structured text and PLCopen XML both write."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """A declared variable.

    Parameters
    ----------
    name, type
        Both as they are written; ``derived`` says that the type is a function block.
    initial
        Literal; empty for the type's own default.
    address
        Of a located variable, like ``%QX0.1``.
    note
        For people.
    """

    name: str
    type: str
    derived: bool = False
    initial: str = ""
    address: str = ""
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """One VAR block; located and unlocated variables never share one."""

    kind: Literal["VAR_INPUT", "VAR_OUTPUT", "VAR", "VAR CONSTANT"]
    variables: tuple[Variable, ...]

    def __post_init__(self) -> None:
        located = [bool(v.address) for v in self.variables]
        if any(located) and not all(located):
            raise ValueError("a VAR block mixes located and unlocated variables")


@dataclass(frozen=True, slots=True, kw_only=True)
class Pou:
    """A program or a function block with its body in structured text."""

    kind: Literal["FUNCTION_BLOCK", "PROGRAM"]
    name: str
    notes: tuple[str, ...]
    blocks: tuple[Block, ...]
    body: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlcProgram:
    """Everything that a controller needs: the block, the program that feeds it, and its task."""

    block: Pou
    main: Pou
    configuration: str
    resource: str
    task: str
    instance: str
    interval_ms: int
