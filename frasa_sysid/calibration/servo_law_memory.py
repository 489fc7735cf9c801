"""Reading and writing C structs at an address, for compiled code that is handed plain pointers.

Addresses are integers here. Nothing is checked: whoever passes one knows what stands there.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

INTEGER, NUMBER = types.int64, types.float64
_I, _F = INTEGER, NUMBER
_Written = TypeVar("_Written", bound=Callable[..., Any])


def compiled(signature: Any) -> Callable[[_Written], _Written]:  # noqa: ANN401 (a numba signature)
    """Compile once, for these types; numba would make a variant for every constant that is passed."""
    return cast(Callable[[_Written], _Written], njit(signature, error_model="numpy"))


def _reader(bits: ir.Type, result: types.Type) -> Any:  # noqa: ANN401
    def read(context: Any, address: Any) -> Any:  # noqa: ANN401 (numba's own protocol)
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
            value = builder.load(builder.inttoptr(args[0], bits.as_pointer()))
            narrow = isinstance(bits, ir.IntType) and bits.width < 64
            return builder.sext(value, ir.IntType(64)) if narrow else value

        return result(_I), generate

    return intrinsic(read)


read_byte: Callable[[int], int] = _reader(ir.IntType(8), _I)
read_int: Callable[[int], int] = _reader(ir.IntType(32), _I)  # also a count of 64 bits: its low half comes first
read_word: Callable[[int], int] = _reader(ir.IntType(64), _I)  # an address
read_number: Callable[[int], float] = _reader(ir.DoubleType(), _F)


def _store(context: Any, address: Any, value: Any) -> Any:  # noqa: ANN401
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
        builder.store(args[1], builder.inttoptr(args[0], ir.DoubleType().as_pointer()))
        return context.get_dummy_value()

    return types.void(_I, _F), generate


put: Callable[[int, float], None] = cast(Callable[[int, float], None], intrinsic(_store))


@compiled(_I(_I, _I, _I))
def integer_at(struct: int, field: int, index: int) -> int:
    """Element of the array of C ints that a struct's field points to."""
    return read_int(read_word(struct + field) + 4 * index)


@compiled(_F(_I, _I, _I))
def number_at(struct: int, field: int, index: int) -> float:
    """Element of the array of doubles that a struct's field points to."""
    return read_number(read_word(struct + field) + 8 * index)
