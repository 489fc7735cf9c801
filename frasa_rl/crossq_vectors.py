"""Vector instructions by name, for loops where a compiler that is left to itself guesses wrongly."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any, TypeVar, cast

import llvmlite.binding as llvm
import numpy.typing as npt
from llvmlite import ir
from numba import config, njit, types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np import arrayobj

from frasa_sysid.calibration.kept_compiled import kept

PANEL = 32
Array = npt.NDArray[Any]  # of float32; of float64 in tests
Value = Any  # a number, vector or pointer of the program that is emitted; llvmlite has no types
_Written = TypeVar("_Written", bound=Callable[..., Any])
_tools: Any = cgutils
_arrays: Any = arrayobj
_types: Any = types
_config: Any = config
_njit: Any = njit
_OPTIONS = {"nogil": True, "error_model": "numpy", "fastmath": {"reassoc", "contract", "nsz"}}
_INNER = {**_OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def compiled(function: _Written) -> _Written:
    """Compile for other compiled code; `entry` is what Python calls."""
    return cast(_Written, _njit(**_INNER)(function))


def as_written(function: _Written) -> _Written:
    """Compile for other compiled code, sums in the order in which they stand."""
    return cast(_Written, _njit(**{**_INNER, "fastmath": {"nsz"}})(function))


def inlined(function: _Written) -> _Written:
    """Compile as a part of its caller: every function called is compiled again within each of its callers."""
    return cast(_Written, _njit(inline="always", **_OPTIONS)(function))


def entry(function: _Written) -> _Written:
    """Compile for Python; what it calls is kept on disk with it."""
    return kept(**_OPTIONS)(function)


def registers() -> tuple[int, int]:
    """Bytes of a vector register, and rows of a tile two registers wide that fits them all.

    NUMBA_CPU_FEATURES, which numba compiles for where it is given, stands in for this processor's own.
    """
    given: str | None = _config.CPU_FEATURES
    features = (
        llvm.get_host_cpu_features() if given is None else {one[1:]: one[0] == "+" for one in given.split(",") if one}
    )
    if features.get("avx512f", False):
        return 64, 8
    if features.get("avx2", False):
        return 32, 4
    return 16, 8 if features.get("neon", False) else 4


class Vectors:
    """Emits loads, stores and arithmetic of vectors that fill a register."""

    def __init__(self, context: Any, builder: Any, number: Any) -> None:  # noqa: ANN401
        self.builder, self._number = builder, context.get_value_type(number)
        self._size = context.get_abi_sizeof(self._number)
        self.lanes = registers()[0] // self._size
        self.type = ir.VectorType(self._number, self.lanes)
        self.zero = ir.Constant(self.type, None)

    def whole(self, value: int) -> Value:
        """A whole number."""
        return ir.IntType(64)(value)

    def loop(self, count: Value) -> AbstractContextManager[Any]:
        """Emit a loop; its `index` counts from 0."""
        done: AbstractContextManager[Any] = _tools.for_range(self.builder, count)
        return done

    def at(self, pointer: Value, offset: Value | int) -> Value:
        """The pointer so many numbers further."""
        return self.builder.gep(pointer, [self.whole(offset) if isinstance(offset, int) else offset])

    def times(self, index: Value, size: Value | int) -> Value:
        """A product of whole numbers."""
        return self.builder.mul(index, self.whole(size) if isinstance(size, int) else size)

    def _place(self, pointer: Value, offset: int) -> Value:
        return self.builder.bitcast(self.at(pointer, offset), self.type.as_pointer())

    def load(self, pointer: Value, offset: int) -> Value:
        """A vector from memory."""
        return self.builder.load(self._place(pointer, offset), align=self._size)

    def store(self, value: Value, pointer: Value, offset: int) -> None:
        """A vector to memory."""
        self.builder.store(value, self._place(pointer, offset), align=self._size)

    def _called(self, name: str, result: Any, given: list[Value]) -> Value:  # noqa: ANN401
        kind = ir.FunctionType(result, [one.type for one in given])
        full = f"llvm.{name}".replace("*", f"v{self.lanes}f{8 * self._size}")
        return self.builder.call(_tools.get_or_insert_function(self.builder.module, kind, full), given)

    def load_some(self, pointer: Value, offset: int, mask: Value) -> Value:
        """Lanes from memory where the mask is set; nothing else is read."""
        given = [self._place(pointer, offset), ir.IntType(32)(self._size), mask, self.zero]
        return self._called("masked.load.*.p0", self.type, given)

    def store_some(self, value: Value, pointer: Value, offset: int, mask: Value) -> None:
        """Lanes to memory where the mask is set."""
        given = [value, self._place(pointer, offset), ir.IntType(32)(self._size), mask]
        self._called("masked.store.*.p0", ir.VoidType(), given)

    def below(self, count: Value, left: int) -> Value:
        """The lanes from column `left` on that lie below a number of columns."""
        whole = ir.VectorType(count.type, self.lanes)
        columns = ir.Constant(whole, list(range(left, left + self.lanes)))
        return self.builder.icmp_signed("<", columns, self._all(count, whole))

    def _all(self, value: Value, kind: Any) -> Value:  # noqa: ANN401
        nothing = ir.Constant(kind, ir.Undefined)
        one = self.builder.insert_element(nothing, value, ir.IntType(32)(0))
        return self.builder.shuffle_vector(one, nothing, ir.Constant(ir.VectorType(ir.IntType(32), self.lanes), None))

    def repeated(self, pointer: Value, offset: int) -> Value:
        """One number from memory in all lanes."""
        return self._all(self.builder.load(self.at(pointer, offset)), self.type)

    def constant(self, value: float) -> Value:
        """The same number in all lanes."""
        return ir.Constant(self.type, [value] * self.lanes)

    def shuffled(self, a: Value, b: Value, order: Sequence[int]) -> Value:
        """Lanes of a, and from `lanes` on of b, in this order."""
        return self.builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), self.lanes), list(order)))

    def product_sum(self, a: Value, b: Value, c: Value) -> Value:
        """Emit a b + c."""
        return self._called("fmuladd.*", self.type, [a, b, c])

    def root(self, a: Value) -> Value:
        """Emit the square root."""
        return self._called("sqrt.*", self.type, [a])

    def within(self, a: Value, low: float, high: float) -> Value:
        """Emit a, limited; not a number stays so."""
        bottom, top = self.constant(low), self.constant(high)
        a = self.builder.select(self.builder.fcmp_ordered("<", a, bottom), bottom, a)
        return self.builder.select(self.builder.fcmp_ordered(">", a, top), top, a)

    def rectified(self, a: Value) -> Value:
        """Emit max(a, 0); not a number stays so."""
        return self.builder.select(self.builder.fcmp_ordered("<", a, self.zero), self.zero, a)

    def where_positive(self, a: Value, b: Value) -> Value:
        """Emit b where a is above 0, else 0."""
        return self.builder.select(self.builder.fcmp_ordered(">", a, self.zero), b, self.zero)

    def total(self, a: Value) -> Value:
        """The sum of the lanes, a single number."""
        half = self.lanes // 2
        while half:
            a = self.builder.fadd(a, self.shuffled(a, a, [k ^ half for k in range(self.lanes)]))
            half //= 2
        return self.builder.extract_element(a, ir.IntType(32)(0))

    def sums(self, count: int) -> list[Value]:
        """Places for sums, at 0; the compiler keeps them in registers."""
        places = [_tools.alloca_once(self.builder, self.type) for _ in range(count)]
        for place in places:
            self.builder.store(self.zero, place)
        return places

    def add(self, place: Value, value: Value) -> None:
        """Add to a sum."""
        self.builder.store(self.builder.fadd(self.builder.load(place), value), place)

    def add_product(self, place: Value, a: Value, b: Value) -> None:
        """Add a product to a sum."""
        self.builder.store(self.product_sum(a, b, self.builder.load(place)), place)


Emit = Callable[[Vectors, list[Value], list[Value]], None]
Emitted = Callable[[tuple[int, ...], tuple[Array, ...]], None]


def emitted(count: int, emit: Emit) -> Emitted:
    """A function for compiled code that emits its own instructions.

    Args:
        count: of whole numbers that it is given, as a tuple; the second tuple is of arrays.
        emit: from vectors, the whole numbers, and where the arrays start.
    """

    def typed(_: Any, __: Any, arrays: Any) -> Any:  # noqa: ANN401 (numba's own protocol)
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
            kinds = list(signature.args[1])
            given = _tools.unpack_tuple(builder, args[1], len(kinds))
            starts = [
                context.make_array(kind)(context, builder, one).data for kind, one in zip(kinds, given, strict=True)
            ]
            emit(Vectors(context, builder, kinds[0].dtype), _tools.unpack_tuple(builder, args[0], count), starts)
            return context.get_dummy_value()

        return types.void(_types.UniTuple(types.intp, count), arrays), generate

    return cast(Emitted, intrinsic(typed))


def _not_inlined(_: Any) -> Any:  # noqa: ANN401
    def mark(context: Any, builder: Any, _: Any, __: Any) -> Any:  # noqa: ANN401
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), mark


def _line(_: Any, matrix: Any, row: Any, start: Any) -> Any:  # noqa: ANN401
    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
        given = context.make_array(signature.args[0])(context, builder, args[0])
        width = builder.extract_value(given.shape, 1)
        data = builder.gep(given.data, [builder.add(builder.mul(args[1], width), args[2])])
        result = context.make_array(signature.return_type)(context, builder)
        size = context.get_constant(types.intp, context.get_abi_sizeof(data.type.pointee))
        left = [builder.sub(width, args[2])]
        _arrays.populate_array(result, data=data, shape=left, strides=[size], itemsize=size, meminfo=None)
        return result._getvalue()

    return types.Array(matrix.dtype, 1, "C")(matrix, types.intp, types.intp), emit


_compiled: Any = intrinsic
# Keeps the function that calls it out of its callers: compiled once, and its registers are its own.
not_inlined: Callable[[], None] = _compiled(_not_inlined)
# Numbers of a matrix's row from a start on; their owner is not kept, which makes it much cheaper than a slice.
line: Callable[[Array, int, int], Array] = _compiled(_line)
