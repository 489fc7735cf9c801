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

    def _masked(self, name: str, kind: Any, mask: Value) -> Any:  # noqa: ANN401
        full = f"llvm.masked.{name}.v{self.lanes}f{8 * self.size}.p0"
        return cgutils.get_or_insert_function(self.builder.module, kind, full)  # type: ignore[no-untyped-call]

    def load_some(self, pointer: Value, offset: int, mask: Value) -> Value:
        """Lanes from memory where the mask is set; nothing else is read."""
        place = self._place(pointer, offset)
        kind = ir.FunctionType(self.type, [place.type, ir.IntType(32), mask.type, self.type])
        return self.builder.call(self._masked("load", kind, mask), [place, ir.IntType(32)(self.size), mask, self.zero])

    def store_some(self, value: Value, pointer: Value, offset: int, mask: Value) -> None:
        """Lanes to memory where the mask is set."""
        place = self._place(pointer, offset)
        kind = ir.FunctionType(ir.VoidType(), [self.type, place.type, ir.IntType(32), mask.type])
        self.builder.call(self._masked("store", kind, mask), [value, place, ir.IntType(32)(self.size), mask])

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

    def root(self, a: Value) -> Value:
        """Emit the square root."""
        return self.builder.call(self._named("sqrt", 1), [a])

    def within(self, a: Value, low: float, high: float) -> Value:
        """Emit a, limited; not a number stays so."""
        bottom, top = self.constant(low), self.constant(high)
        a = self.builder.select(self.builder.fcmp_ordered("<", a, bottom), bottom, a)
        return self.builder.select(self.builder.fcmp_ordered(">", a, top), top, a)

    def constant(self, value: float) -> Value:
        """The same number in all lanes."""
        return ir.Constant(self.type, [value] * self.lanes)

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


Row = Callable[[Vectors, list[Value], list[Value], list[Value]], tuple[list[Value | None], list[Value]]]


def over_rows(panels: int, far: int, factors: int, constants: int, totals: int, row: Row) -> Any:  # noqa: ANN401, PLR0913
    """An intrinsic that goes through rows of 32 numbers.

    It is called as loop(count, stride, (panels ..., factors ..., constants ..., totals ...)), all one-dimensional
    arrays: panels of `count` rows, one factor for each row, 32 constants, 32 totals that are set to sums over rows.

    Args:
        panels, factors, constants, totals: how many of each.
        far: how many panels, the first ones, have rows that start `stride` apart and not 32.
        row: emits what happens to a vector of a row, from those of the panels, factors and constants: new values of
            the first panels (none: it stays), and what is added to each total.
    """

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Value:  # noqa: ANN401
        kinds = list(signature.args[2])
        vectors = Vectors(context, builder, kinds[0].dtype)
        arrays = cgutils.unpack_tuple(builder, args[2], len(kinds))  # type: ignore[no-untyped-call]
        given = [context.make_array(kind)(context, builder, one).data for kind, one in zip(kinds, arrays, strict=True)]
        sheets, singles = given[:panels], given[panels : panels + factors]
        fixed, results = given[panels + factors : panels + factors + constants], given[panels + factors + constants :]
        chunks = range(0, PANEL, vectors.lanes)
        kept = {left: [vectors.load(one, left) for one in fixed] for left in chunks}
        sums = {left: vectors.sums(totals) for left in chunks}
        with cgutils.for_range(builder, args[0]) as loop:  # type: ignore[no-untyped-call]
            starts = [builder.mul(loop.index, width) for width in (args[1], args[1].type(PANEL))]
            here = [builder.gep(one, [starts[0 if i < far else 1]]) for i, one in enumerate(sheets)]
            scaled = [vectors.repeated(builder.gep(one, [loop.index]), 0) for one in singles]
            for left in chunks:
                new, added = row(vectors, [vectors.load(one, left) for one in here], scaled, kept[left])
                for value, place in zip(new, here, strict=False):
                    if value is not None:
                        vectors.store(value, place, left)
                for place, value in zip(sums[left], added, strict=True):
                    vectors.add(place, value)
        for left in chunks:
            for place, result in zip(sums[left], results, strict=True):
                vectors.store(builder.load(place), result, left)
        return context.get_dummy_value()

    @intrinsic  # type: ignore[untyped-decorator]
    def loop(_: Any, count: Any, stride: Any, arrays: Any) -> Any:  # noqa: ANN401
        return types.void(types.intp, types.intp, arrays), emit

    return loop


@intrinsic  # type: ignore[untyped-decorator]
def transpose(_: Any, to: Any, to_at: Any, source: Any, at: Any) -> Any:  # noqa: ANN401
    """transpose(to, to_at, source, at): 32 x 32 numbers, rows of 32 in both, through registers."""

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Value:  # noqa: ANN401
        vectors = Vectors(context, builder, signature.args[0].dtype)
        lanes = vectors.lanes
        to, source = (
            builder.gep(context.make_array(signature.args[i])(context, builder, args[i]).data, [args[i + 1]])
            for i in (0, 2)
        )
        for top in range(0, PANEL, lanes):
            for left in range(0, PANEL, lanes):
                rows = [vectors.load(source, (top + i) * PANEL + left) for i in range(lanes)]
                for i, row in enumerate(_turned(vectors, rows)):
                    vectors.store(row, to, (left + i) * PANEL + top)
        return context.get_dummy_value()

    return types.void(to, types.intp, source, types.intp), emit


def _turned(vectors: Vectors, rows: list[Value]) -> list[Value]:
    """Rows of a square as columns: swap its off-diagonal quarters, then theirs within each quarter, and so on."""
    lanes, half = vectors.lanes, vectors.lanes // 2
    while half:
        new = list(rows)
        for i in range(lanes):
            if i & half:
                continue
            a, b = rows[i], rows[i | half]
            new[i] = vectors.shuffled(a, b, [lanes + (k ^ half) if k & half else k for k in range(lanes)])
            new[i | half] = vectors.shuffled(a, b, [lanes + k if k & half else k ^ half for k in range(lanes)])
        rows, half = new, half // 2
    return rows


@intrinsic  # type: ignore[untyped-decorator]
def dot_rows(_: Any, count: Any, panels: Any, jump: Any, arrays: Any) -> Any:  # noqa: ANN401
    """dot_rows(count, panels, jump, (to, x, weight)): to[n] += x[n, :] weight, panels of x `jump` numbers apart."""

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Value:  # noqa: ANN401
        kinds = list(signature.args[3])
        vectors = Vectors(context, builder, kinds[0].dtype)
        arrays = cgutils.unpack_tuple(builder, args[3], 3)  # type: ignore[no-untyped-call]
        to, x, w = (context.make_array(k)(context, builder, one).data for k, one in zip(kinds, arrays, strict=True))
        places = vectors.sums(PANEL // vectors.lanes)
        with cgutils.for_range(builder, args[0]) as row:  # type: ignore[no-untyped-call]
            for place in places:
                builder.store(vectors.zero, place)
            start = builder.mul(row.index, args[0].type(PANEL))
            with cgutils.for_range(builder, args[1]) as panel:  # type: ignore[no-untyped-call]
                here = builder.gep(x, [builder.add(start, builder.mul(panel.index, args[2]))])
                factor = builder.gep(w, [builder.mul(panel.index, args[0].type(PANEL))])
                for i, place in enumerate(places):
                    left = i * vectors.lanes
                    total = vectors.product_sum(
                        vectors.load(here, left), vectors.load(factor, left), builder.load(place)
                    )
                    builder.store(total, place)
            total = builder.load(places[0])
            for place in places[1:]:
                total = builder.fadd(total, builder.load(place))
            half = vectors.lanes // 2
            while half:
                order = [k ^ half for k in range(vectors.lanes)]
                total, half = builder.fadd(total, vectors.shuffled(total, total, order)), half // 2
            result = builder.gep(to, [row.index])
            one = builder.extract_element(total, ir.IntType(32)(0))
            builder.store(builder.fadd(builder.load(result), one), result)
        return context.get_dummy_value()

    whole = types.intp
    return types.void(whole, whole, whole, arrays), emit


@intrinsic  # type: ignore[untyped-decorator]
def copy_columns(_: Any, rows: Any, columns: Any, to: Any, to_at: Any, source: Any, at: Any, stride: Any) -> Any:  # noqa: ANN401, PLR0913
    """copy_columns(rows, columns, to, to_at, source, at, stride): the first of 32 columns, rows of `to` are 32 long."""

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Value:  # noqa: ANN401
        vectors = Vectors(context, builder, signature.args[2].dtype)
        to, source = (
            builder.gep(context.make_array(signature.args[i])(context, builder, args[i]).data, [args[i + 1]])
            for i in (2, 4)
        )
        whole = args[1].type
        numbers = ir.VectorType(whole, vectors.lanes)
        nothing = ir.Constant(numbers, ir.Undefined)
        first = builder.insert_element(nothing, args[1], ir.IntType(32)(0))
        many = builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(ir.IntType(32), vectors.lanes), None))
        masks = {
            left: builder.icmp_signed("<", ir.Constant(numbers, list(range(left, left + vectors.lanes))), many)
            for left in range(0, PANEL, vectors.lanes)
        }
        with cgutils.for_range(builder, args[0]) as row:  # type: ignore[no-untyped-call]
            here = builder.gep(source, [builder.mul(row.index, args[6])])
            there = builder.gep(to, [builder.mul(row.index, whole(PANEL))])
            for left, mask in masks.items():
                vectors.store_some(vectors.load_some(here, left, mask), there, left, mask)
        return context.get_dummy_value()

    whole = types.intp
    return types.void(whole, whole, to, whole, source, whole, whole), emit
