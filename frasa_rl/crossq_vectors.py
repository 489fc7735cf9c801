"""Vector instructions by name, for loops where a compiler that is left to itself guesses wrongly."""

from collections.abc import Sequence
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np import arrayobj

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


def pointer(context: Any, builder: Any, kind: Any, array: Value) -> Value:  # noqa: ANN401
    """Where an array's numbers start."""
    return context.make_array(kind)(context, builder, array).data


@intrinsic  # type: ignore[untyped-decorator]
def line(_: Any, matrix: Any, row: Any, start: Any) -> Any:  # noqa: ANN401
    """line(matrix, row, start): numbers of a row from `start` on, whose owner is not kept (a slice costs much more)."""

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Value:  # noqa: ANN401
        given = context.make_array(signature.args[0])(context, builder, args[0])
        width = builder.extract_value(given.shape, 1)
        data = builder.gep(given.data, [builder.add(builder.mul(args[1], width), args[2])])
        result = context.make_array(signature.return_type)(context, builder)
        stride = context.get_constant(types.intp, context.get_abi_sizeof(data.type.pointee))
        arrayobj.populate_array(
            result,
            data=data,
            shape=[builder.sub(width, args[2])],
            strides=[stride],
            itemsize=stride,
            meminfo=None,
        )
        return result._getvalue()

    return types.Array(matrix.dtype, 1, "C")(matrix, types.intp, types.intp), emit


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

    def below(self, count: Value, left: int) -> Value:
        """The lanes from column `left` on that lie below a whole number of columns."""
        whole = ir.VectorType(count.type, self.lanes)
        nothing = ir.Constant(whole, ir.Undefined)
        first = self.builder.insert_element(nothing, count, ir.IntType(32)(0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), self.lanes), None)
        many = self.builder.shuffle_vector(first, nothing, zeros)
        return self.builder.icmp_signed("<", ir.Constant(whole, list(range(left, left + self.lanes))), many)

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
