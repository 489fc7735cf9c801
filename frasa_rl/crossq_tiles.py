"""Matrix products for the learner on a processor, in the order of memory that makes small ones fast.

A matrix of activations (n rows, d columns) is kept in *panels* of 32 columns, shape (ceil(d / 32), n, 32), zero where
there is no column. A tile of 8 x 32 results then fits the vector registers, and everything that it reads lies in one
line after the other, so nothing is packed as a BLAS must. One thread does all: the other cores simulate.
"""

from typing import Any

import numpy.typing as npt
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from frasa_rl.crossq_vectors import PANEL, Value, Vectors, not_inlined, pointer, registers

Array = npt.NDArray[Any]  # of float32; of float64 in tests

ROWS = 8  # rows are padded to a multiple of it
_UNROLLED = 4

compiled = njit(nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"}, cache=True)


def _emit(context: Any, builder: Any, signature: Any, args: Any, transposed: bool) -> Any:  # noqa: ANN401
    """The instructions of `_tile`."""
    c, a, b = (builder.gep(pointer(context, builder, signature.args[i], args[i]), [args[i + 1]]) for i in (0, 2, 5))
    a_jump, b_jump, panels, length = args[4], args[7], args[8], args[9]
    vectors = Vectors(context, builder, signature.args[0].dtype)
    rows, lanes, whole = registers()[1], vectors.lanes, a_jump.type
    tall, wide = (1, PANEL) if transposed else (PANEL, 1)  # steps of a's element [i, k] in i and in k
    for top in range(0, ROWS, rows):
        for left in range(0, PANEL, 2 * lanes):
            sums = [vectors.sums(2) for _ in range(rows)]
            with cgutils.for_range(builder, panels) as panel:
                a_panel = builder.gep(a, [builder.mul(panel.index, a_jump)])
                b_panel = builder.gep(b, [builder.mul(panel.index, b_jump)])
                with cgutils.for_range(builder, builder.udiv(length, whole(_UNROLLED))) as loop:
                    a_here = builder.gep(a_panel, [builder.mul(loop.index, whole(_UNROLLED * wide))])
                    b_here = builder.gep(b_panel, [builder.mul(loop.index, whole(_UNROLLED * PANEL))])
                    for k in range(_UNROLLED):
                        right = [vectors.load(b_here, k * PANEL + left + j * lanes) for j in range(2)]
                        for i in range(rows):
                            factor = vectors.repeated(a_here, k * wide + (top + i) * tall)
                            for j in range(2):
                                total = vectors.product_sum(factor, right[j], builder.load(sums[i][j]))
                                builder.store(total, sums[i][j])
            for i in range(rows):
                for j in range(2):
                    vectors.store(builder.load(sums[i][j]), c, (top + i) * PANEL + left + j * lanes)
    return context.get_dummy_value()


def _tile(transposed: bool) -> Any:  # noqa: ANN401 (numba's functions have no type)
    """Sum over k of a[i, k] b[k, j] for 8 rows i and 32 columns j, written in vectors by hand.

    Element [i, k] of `a` is at 32 i + k, or at 32 k + i where it is read transposed; rows of `b` and of the result are
    32 long. The sum runs over `panels` stretches of `length` (a multiple of 4), which lie a_jump and b_jump apart.
    """

    @intrinsic  # type: ignore[untyped-decorator]
    def tile(  # noqa: ANN202
        _: Any,
        c: Any,
        c_at: Any,
        a: Any,
        a_at: Any,
        a_jump: Any,
        b: Any,
        b_at: Any,
        b_jump: Any,
        panels: Any,
        length: Any,
    ):  # type: ignore[no-untyped-def]
        place = types.intp
        signature = types.void(c, place, a, place, place, b, place, place, place, place)
        return signature, lambda *given: _emit(*given, transposed)

    return tile


_tile_plain = _tile(transposed=False)
_tile_transposed = _tile(transposed=True)


@compiled
def product(c: Array, c_at: int, a: Array, a_at: int, rows: int, b: Array, b_at: int, panels: int) -> None:
    """One panel of a product, shape (rows, 32): `a` of `panels` panels of `rows` times `b`, shape (32 panels, 32)."""
    not_inlined()
    for i in range(0, rows * PANEL, ROWS * PANEL):
        _tile_plain(c, c_at + i, a, a_at + i, rows * PANEL, b, b_at, PANEL * PANEL, panels, PANEL)


@compiled
def product_of_rows(c: Array, a: Array, a_at: int, panels: int, b: Array, b_at: int, rows: int) -> None:
    """Sum over n of a[n, o] b[n, j], shape (32 panels, 32): `a` of `panels` panels of `rows`, one panel of `b`."""
    not_inlined()
    for panel in range(panels):
        for i in range(0, PANEL, ROWS):
            _tile_transposed(c, (panel * PANEL + i) * PANEL, a, a_at + panel * rows * PANEL + i, 0, b, b_at, 0, 1, rows)
