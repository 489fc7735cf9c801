"""Loops in vector instructions by name, where a compiler that is left to itself guesses wrongly.

What a loop over the rows of a panel does to one row of 32 numbers is given as a function that emits it; constants stay
in registers, sums too.
"""

from collections.abc import Callable, Sequence
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

PANEL = 32
Value = Any  # a vector of numbers in the program that is emitted; llvmlite has no types


def registers() -> tuple[int, int]:
    """Bytes of a vector register, and rows of a tile two registers wide that fits them all."""
    features = llvm.get_host_cpu_features()
    if features.get("avx512f", False):
        return 64, 8
    if features.get("avx2", False):
        return 32, 4
    return 16, 8 if features.get("neon", False) else 4


@intrinsic  # type: ignore[untyped-decorator]
def not_inlined(_: Any) -> Any:  # noqa: ANN401
    """Keep the function that calls this out of its callers: compiled once, and its registers are its own."""

    def mark(context: Any, builder: Any, _: Any, __: Any) -> Value:  # noqa: ANN401
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), mark


class Vectors:
    """Emits loads, stores and arithmetic of vectors that fill a register."""

    def __init__(self, context: Any, builder: Any, number: Any) -> None:  # noqa: ANN401
        self.builder, self.number = builder, context.get_value_type(number)
        self.size = context.get_abi_sizeof(self.number)
        self.lanes = registers()[0] // self.size
        self.type = ir.VectorType(self.number, self.lanes)
        self.zero = ir.Constant(self.type, None)

    def _named(self, name: str, count: int) -> Any:  # noqa: ANN401
        kind = ir.FunctionType(self.type, [self.type] * count)
        full = f"llvm.{name}.v{self.lanes}f{8 * self.size}"
        return cgutils.get_or_insert_function(self.builder.module, kind, full)  # type: ignore[no-untyped-call]

    def at(self, pointer: Value, offset: int) -> Value:
        """The pointer so many numbers further."""
        return self.builder.gep(pointer, [ir.IntType(64)(offset)])

    def _place(self, pointer: Value, offset: int) -> Value:
        return self.builder.bitcast(self.at(pointer, offset), self.type.as_pointer())

    def load(self, pointer: Value, offset: int) -> Value:
        """A vector from memory."""
        return self.builder.load(self._place(pointer, offset), align=self.size)

    def store(self, value: Value, pointer: Value, offset: int) -> None:
        """A vector to memory."""
        self.builder.store(value, self._place(pointer, offset), align=self.size)

    def repeated(self, pointer: Value, offset: int) -> Value:
        """One number from memory in all lanes."""
        nothing = ir.Constant(self.type, ir.Undefined)
        one = self.builder.insert_element(nothing, self.builder.load(self.at(pointer, offset)), ir.IntType(32)(0))
        return self.builder.shuffle_vector(one, nothing, ir.Constant(ir.VectorType(ir.IntType(32), self.lanes), None))

    def shuffled(self, a: Value, b: Value, order: Sequence[int]) -> Value:
        """Lanes of a, and from `lanes` on of b, in this order."""
        mask = ir.Constant(ir.VectorType(ir.IntType(32), self.lanes), list(order))
        return self.builder.shuffle_vector(a, b, mask)

    def product_sum(self, a: Value, b: Value, c: Value) -> Value:
        """Emit a b + c."""
        return self.builder.call(self._named("fmuladd", 3), [a, b, c])

    def rectified(self, a: Value) -> Value:
        """Emit max(a, 0); not a number stays so."""
        return self.builder.select(self.builder.fcmp_ordered("<", a, self.zero), self.zero, a)

    def where_positive(self, a: Value, b: Value) -> Value:
        """Emit b where a is above 0, else 0."""
        return self.builder.select(self.builder.fcmp_ordered(">", a, self.zero), b, self.zero)

    def sums(self, count: int) -> list[Value]:
        """Places for sums, at 0; the compiler keeps them in registers."""
        places = [cgutils.alloca_once(self.builder, self.type) for _ in range(count)]  # type: ignore[no-untyped-call]
        for place in places:
            self.builder.store(self.zero, place)
        return places

    def add(self, place: Value, value: Value) -> None:
        """Add to a sum."""
        self.builder.store(self.builder.fadd(self.builder.load(place), value), place)


Row = Callable[[Vectors, list[Value], list[Value], list[Value]], tuple[Value | None, list[Value]]]


def over_rows(panels: int, factors: int, constants: int, totals: int, row: Row) -> Any:  # noqa: ANN401
    """An intrinsic that goes through rows of 32 numbers.

    It is called as loop(count, (panels ..., factors ..., constants ..., totals ...)), all one-dimensional arrays: panels
    of `count` rows, one factor for each row, 32 constants, 32 totals that are set to sums over rows.

    Args:
        panels, factors, constants, totals: how many of each.
        row: emits what happens to a vector of a row, from those of the panels, factors and constants: the first
            panel's new value (none: it stays), and what is added to each total.
    """

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Value:  # noqa: ANN401
        kinds = list(signature.args[1])
        vectors = Vectors(context, builder, kinds[0].dtype)
        arrays = cgutils.unpack_tuple(builder, args[1], len(kinds))  # type: ignore[no-untyped-call]
        given = [context.make_array(kind)(context, builder, one).data for kind, one in zip(kinds, arrays, strict=True)]
        sheets, singles = given[:panels], given[panels : panels + factors]
        fixed, results = given[panels + factors : panels + factors + constants], given[panels + factors + constants :]
        chunks = range(0, PANEL, vectors.lanes)
        kept = {left: [vectors.load(one, left) for one in fixed] for left in chunks}
        sums = {left: vectors.sums(totals) for left in chunks}
        with cgutils.for_range(builder, args[0]) as loop:  # type: ignore[no-untyped-call]
            start = builder.mul(loop.index, args[0].type(PANEL))
            here = [builder.gep(one, [start]) for one in sheets]
            scaled = [vectors.repeated(builder.gep(one, [loop.index]), 0) for one in singles]
            for left in chunks:
                new, added = row(vectors, [vectors.load(one, left) for one in here], scaled, kept[left])
                if new is not None:
                    vectors.store(new, here[0], left)
                for place, value in zip(sums[left], added, strict=True):
                    vectors.add(place, value)
        for left in chunks:
            for place, result in zip(sums[left], results, strict=True):
                vectors.store(builder.load(place), result, left)
        return context.get_dummy_value()

    @intrinsic  # type: ignore[untyped-decorator]
    def loop(_: Any, count: Any, arrays: Any) -> Any:  # noqa: ANN401
        return types.void(types.intp, arrays), emit

    return loop
