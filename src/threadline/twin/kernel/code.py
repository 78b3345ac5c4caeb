"""Write machine code from Python: values with operators, loops and branches, over LLVM.

A kernel is written once for plain numbers and for vectors of ``width`` variants: the same
operations in the same order, and a fused multiply-add only at ``fma``. The optimiser may not do
anything that changes a bit of a result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import ir

DOUBLE, INTEGER, POINTER, BIT, VOID = (
    ir.DoubleType(),
    ir.IntType(64),
    ir.PointerType(),
    ir.IntType(1),
    ir.VoidType(),
)


class Value:
    """A number or truth value, or a vector of either, in the code being written."""

    __slots__ = ("code", "ir")

    def __init__(self, code: Code, value: Any) -> None:
        self.code, self.ir = code, value

    def __add__(self, other: Number) -> Value:
        return self.code.binary("add", self, other)

    def __sub__(self, other: Number) -> Value:
        return self.code.binary("sub", self, other)

    def __rsub__(self, other: float) -> Value:
        return Value(self.code, self.code.lift(other, self.ir.type)) - self

    def __mul__(self, other: Number) -> Value:
        return self.code.binary("mul", self, other)

    def __truediv__(self, other: Number) -> Value:
        return self.code.binary("div", self, other)

    def __and__(self, other: Value) -> Value:
        return Value(self.code, self.code.at.and_(self.ir, other.ir))

    def __or__(self, other: Value) -> Value:
        return Value(self.code, self.code.at.or_(self.ir, other.ir))

    def __invert__(self) -> Value:
        return Value(self.code, self.code.at.not_(self.ir))

    def __lt__(self, other: Number) -> Value:
        return self.code.compare("<", self, other)

    def __gt__(self, other: Number) -> Value:
        return self.code.compare(">", self, other)

    def __le__(self, other: Number) -> Value:
        return self.code.compare("<=", self, other)

    def __ge__(self, other: Number) -> Value:
        return self.code.compare(">=", self, other)

    def equals(self, other: Number) -> Value:
        """Return whether both are equal."""
        return self.code.compare("==", self, other)


Number = Value | float | int


class Code:
    """Writes one function of a module.

    Parameters
    ----------
    module
        Module of the function.
    name
        Its name in the module.
    arguments
        Types of its arguments.
    width
        Numbers in a vector; 1 for plain numbers.
    apart
        Whether the function must not be inlined.
    """

    def __init__(
        self, module: ir.Module, name: str, arguments: tuple[Any, ...], width: int, apart: bool
    ) -> None:
        self.width = width
        self.vector = DOUBLE if width == 1 else ir.VectorType(DOUBLE, width)
        self.mask = BIT if width == 1 else ir.VectorType(BIT, width)
        self.function = ir.Function(module, ir.FunctionType(VOID, arguments), name)
        if apart:
            self.function.attributes.add("noinline")
        self.head = ir.IRBuilder(self.function.append_basic_block("head"))
        first = self.function.append_basic_block("body")
        self.at = ir.IRBuilder(first)
        self.arguments = [Value(self, a) for a in self.function.args]
        self._first = first

    def finish(self) -> None:
        """End the function."""
        self.at.ret_void()
        self.head.branch(self._first)

    # --- numbers ---------------------------------------------------------------------------

    def lift(self, number: Number, like: Any) -> Any:
        """Return ``number`` as an operand of type ``like``."""
        if isinstance(number, Value):
            value = number.ir
            if value.type == like or isinstance(like, ir.IntType):
                return value
            assert value.type == DOUBLE and isinstance(like, ir.VectorType)
            one = self.at.insert_element(ir.Constant(like, ir.Undefined), value, _lane(0))
            zeros = ir.Constant(ir.VectorType(ir.IntType(32), self.width), [0] * self.width)
            return self.at.shuffle_vector(one, ir.Constant(like, ir.Undefined), zeros)
        if isinstance(like, ir.VectorType):
            return ir.Constant(like, [float(number)] * self.width)
        return ir.Constant(like, float(number) if like == DOUBLE else int(number))

    def _pair(self, a: Value, b: Number) -> tuple[Any, Any]:
        like = a.ir.type
        if isinstance(b, Value) and isinstance(b.ir.type, ir.VectorType):
            like = b.ir.type
        return self.lift(a, like), self.lift(b, like)

    def binary(self, what: str, a: Value, b: Number) -> Value:
        """Return ``a what b`` for add, sub, mul, div."""
        one, other = self._pair(a, b)
        prefix = "" if isinstance(one.type, ir.IntType) else "f"
        return Value(self, getattr(self.at, prefix + what)(one, other))

    def compare(self, sign: str, a: Value, b: Number) -> Value:
        """Return whether ``a sign b``; false if either is NaN."""
        one, other = self._pair(a, b)
        if isinstance(one.type, ir.IntType):
            return Value(self, self.at.icmp_signed(sign, one, other))
        return Value(self, self.at.fcmp_ordered(sign, one, other))

    def number(self, value: float) -> Value:
        """Return a constant vector."""
        return Value(self, self.lift(value, self.vector))

    def integer(self, value: int) -> Value:
        """Return a constant integer."""
        return Value(self, ir.Constant(INTEGER, value))

    def call(self, name: str, *operands: Value, flags: tuple[str, ...] = ()) -> Value:
        """Return the result of an intrinsic such as ``floor``; its operands have one type."""
        kind = operands[0].ir.type
        suffix = f"v{self.width}f64" if isinstance(kind, ir.VectorType) else "f64"
        return Value(self, self.at.call(
            _declared(self.at.module, f"llvm.{name}.{suffix}", kind, [kind] * len(operands)),
            [o.ir for o in operands],
            fastmath=flags,
        ))  # fmt: skip

    def ones(self, bits: Value) -> Value:
        """Return the number of set bits of an integer."""
        count = _declared(self.at.module, "llvm.ctpop.i64", INTEGER, [INTEGER])
        return Value(self, self.at.call(count, [bits.ir]))

    def first_bit(self, bits: Value) -> Value:
        """Return the index of the lowest set bit."""
        count = _declared(self.at.module, "llvm.cttz.i64", INTEGER, [INTEGER, BIT])
        return Value(self, self.at.call(count, [bits.ir, ir.Constant(BIT, 1)]))

    def to_integer(self, value: Value) -> Value:
        """Return a whole number as an integer."""
        return Value(self, self.at.fptosi(value.ir, INTEGER))

    def to_number(self, value: Value) -> Value:
        """Return an integer as a vector of equal numbers."""
        return self.splat(Value(self, self.at.sitofp(value.ir, DOUBLE)))

    def splat(self, number: Value) -> Value:
        """Return a vector of equal numbers."""
        return Value(self, self.lift(number, self.vector))

    def fma(self, a: Value, b: Number, c: Number) -> Value:
        """Return ``a b + c``, rounded once."""
        one, other = self._pair(a, b)
        last = self.lift(c, one.type)
        return self.call("fma", Value(self, one), Value(self, other), Value(self, last))

    def choose(self, which: Value, a: Number, b: Number) -> Value:
        """Return a where ``which`` is true, else b."""
        like = self.vector
        if not isinstance(which.ir.type, ir.VectorType):
            like = next((v.ir.type for v in (a, b) if isinstance(v, Value)), self.vector)
        return Value(self, self.at.select(which.ir, self.lift(a, like), self.lift(b, like)))

    def larger(self, a: Value, b: Value) -> Value:
        """Return the larger of two numbers."""
        return self.call("maxnum", a, b, flags=("nnan",))

    def smaller(self, a: Value, b: Value) -> Value:
        """Return the smaller of two numbers."""
        return self.call("minnum", a, b, flags=("nnan",))

    def total(self, terms: list[tuple[Value, Value]], start: Value | None = None) -> Value:
        """Return ``start`` plus the products of the terms, summed in order."""
        total = start
        for a, b in terms:
            total = a * b if total is None else self.fma(a, b, total)
        return self.number(0.0) if total is None else total

    def any_negative(self, values: list[Value]) -> Value:
        """Return the lanes in which one of the values is negative."""
        kind = INTEGER if self.width == 1 else ir.VectorType(INTEGER, self.width)
        signs = self.at.bitcast(values[0].ir, kind)
        for value in values[1:]:
            signs = self.at.or_(signs, self.at.bitcast(value.ir, kind))
        zero = ir.Constant(kind, 0 if self.width == 1 else [0] * self.width)
        return Value(self, self.at.icmp_signed("<", signs, zero))

    # --- truth -----------------------------------------------------------------------------

    def bits(self, mask: Value) -> Value:
        """Return a mask as an integer, the first variant in the lowest bit."""
        value = mask.ir
        if self.width > 1:
            value = self.at.bitcast(value, ir.IntType(self.width))
        return Value(self, value if self.width == 64 else self.at.zext(value, INTEGER))

    def from_bits(self, bits: Value) -> Value:
        """Return the mask of ``bits``."""
        value = self.at.trunc(bits.ir, ir.IntType(self.width))
        return Value(self, value if self.width == 1 else self.at.bitcast(value, self.mask))

    def any(self, mask: Value) -> Value:
        """Return whether a mask is true in any lane."""
        return ~self.bits(mask).equals(0)

    # --- memory ----------------------------------------------------------------------------

    def place(self, base: Value, index: Number, kind: Any = DOUBLE) -> Value:
        """Return the address of element ``index`` from ``base``."""
        at = self.lift(index, INTEGER)
        return Value(self, self.at.gep(base.ir, [at], source_etype=kind))

    def read(self, base: Value, index: Number, kind: Any = DOUBLE) -> Value:
        """Return element ``index`` of an array of ``kind``."""
        where = self.place(base, index, kind)
        return Value(self, self.at.load(where.ir, typ=kind, align=8))

    def write(self, base: Value, index: Number, value: Value, kind: Any = DOUBLE) -> None:
        """Set element ``index`` of an array of ``kind``."""
        self.at.store(value.ir, self.place(base, index, kind).ir, align=8)

    def read_lanes(self, base: Value, index: Number) -> Value:
        """Return the vector that begins at element ``index``."""
        return Value(self, self.at.load(self.place(base, index).ir, typ=self.vector, align=8))

    def write_lanes(self, base: Value, index: Number, value: Number) -> None:
        """Store a vector, its first number at element ``index``."""
        self.at.store(self.lift(value, self.vector), self.place(base, index).ir, align=8)

    def space(self, count: int) -> Value:
        """Return memory for ``count`` numbers, valid while the function runs."""
        room = self.head.alloca(DOUBLE, ir.Constant(ir.IntType(32), count))
        room.align, room.type = 64, POINTER
        return Value(self, room)

    def variable(self, kind: Any, value: Number) -> Variable:
        """Return a variable of the function being written, with an initial value."""
        made = Variable(self, Value(self, self.head.alloca(kind)), kind)
        made.set(value)
        return made

    # --- control ---------------------------------------------------------------------------

    @contextmanager
    def when(self, condition: Value) -> Iterator[None]:
        """Write code that runs only if ``condition`` is true."""
        with self.at.if_then(condition.ir):
            yield

    @contextmanager
    def when_seldom(self, condition: Value) -> Iterator[None]:
        """Like ``when``, for a rarely true condition."""
        with self.at.if_then(condition.ir, likely=False):
            yield

    @contextmanager
    def count(self, begin: Number, end: Number, step: int = 1) -> Iterator[Value]:
        """Write code that runs for begin, begin + step, ... below ``end``."""
        index = self.variable(INTEGER, begin)
        with self.loop() as leave:
            now = index.get()
            leave(now >= end)
            yield now
            index.set(now + step)

    @contextmanager
    def loop(self) -> Iterator[Callable[[Value], None]]:
        """Write code that repeats until the yielded function gets a true value."""
        begin = self.at.append_basic_block("again")
        after = self.at.append_basic_block("after")
        self.at.branch(begin)
        self.at.position_at_end(begin)

        def leave(condition: Value) -> None:
            onward = self.at.append_basic_block("onward")
            self.at.cbranch(condition.ir, after, onward)
            self.at.position_at_end(onward)

        yield leave
        self.at.branch(begin)
        self.at.position_at_end(after)

    def run(self, function: Any, *arguments: Value) -> None:
        """Call a function of the module."""
        self.at.call(function, [a.ir for a in arguments])

    def run_address(self, address: Value, *arguments: Value) -> None:
        """Call the function at an address."""
        kind = ir.FunctionType(VOID, [a.ir.type for a in arguments])
        pointer = self.at.inttoptr(address.ir, ir.PointerType(kind))
        self.at.call(pointer, [a.ir for a in arguments])


class Variable:
    """A variable in the code being written."""

    __slots__ = ("code", "kind", "where")

    def __init__(self, code: Code, where: Value, kind: Any) -> None:
        self.code, self.where, self.kind = code, where, kind

    def get(self) -> Value:
        """Return its present value."""
        return Value(self.code, self.code.at.load(self.where.ir, typ=self.kind))

    def set(self, value: Number) -> None:
        """Set it."""
        self.code.at.store(self.code.lift(value, self.kind), self.where.ir)


def _lane(index: int) -> Any:
    return ir.Constant(ir.IntType(32), index)


def _declared(module: ir.Module, name: str, kind: Any, arguments: list[Any]) -> Any:
    found = module.globals.get(name)
    return found or ir.Function(module, ir.FunctionType(kind, arguments), name)
