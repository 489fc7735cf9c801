"""Matrix products for the learner on a processor, in the order of memory that makes small ones fast.

A matrix of activations (n rows, d columns) is kept in *panels* of 32 columns, shape (ceil(d / 32), n, 32), zero where
there is no column. A tile of 8 x 32 results then fits the vector registers, and everything that it reads lies in one
line after the other, so nothing is packed as a BLAS must. One thread does all: the other cores simulate.
"""

from frasa_rl.crossq_vectors import PANEL, Array, Emitted, Value, Vectors, compiled, emitted, not_inlined, registers

ROWS = 8  # rows are padded to a multiple of it
_UNROLLED = 4


def _tile(transposed: bool) -> Emitted:
    """Sum over k of a[i, k] b[k, j] for 8 rows i and 32 columns j.

    It is called as tile((c_at, a_at, a_jump, b_at, b_jump, panels, length), (c, a, b)). Element [i, k] of `a` is at
    32 i + k, or at 32 k + i where it is read transposed; rows of `b` and of the result are 32 long. The sum runs over
    `panels` stretches of `length` (a multiple of 4), which lie a_jump and b_jump apart.
    """
    tall, wide = (1, PANEL) if transposed else (PANEL, 1)  # steps of a's element [i, k] in i and in k

    def emit(v: Vectors, numbers: list[Value], given: list[Value]) -> None:
        c_at, a_at, a_jump, b_at, b_jump, panels, length = numbers
        c, a, b = (v.at(one, at) for one, at in zip(given, (c_at, a_at, b_at), strict=True))
        rows, quarter = registers()[1], v.builder.udiv(length, v.whole(_UNROLLED))
        for top in range(0, ROWS, rows):
            for left in range(0, PANEL, 2 * v.lanes):
                sums = [v.sums(2) for _ in range(rows)]
                with v.loop(panels) as panel, v.loop(quarter) as loop:
                    a_row = v.at(v.at(a, v.times(panel.index, a_jump)), v.times(loop.index, _UNROLLED * wide))
                    b_row = v.at(v.at(b, v.times(panel.index, b_jump)), v.times(loop.index, _UNROLLED * PANEL))
                    for k in range(_UNROLLED):
                        right = [v.load(b_row, k * PANEL + left + j * v.lanes) for j in range(2)]
                        for i in range(rows):
                            factor = v.repeated(a_row, k * wide + (top + i) * tall)
                            for j in range(2):
                                v.add_product(sums[i][j], factor, right[j])
                for i in range(rows):
                    for j in range(2):
                        v.store(v.builder.load(sums[i][j]), c, (top + i) * PANEL + left + j * v.lanes)

    return emitted(7, emit)


_tile_plain = _tile(transposed=False)
_tile_transposed = _tile(transposed=True)


@compiled
def product(c: Array, c_at: int, a: Array, a_at: int, rows: int, b: Array, b_at: int, panels: int) -> None:
    """One panel of a product, shape (rows, 32): `a` of `panels` panels of `rows` times `b`, shape (32 panels, 32)."""
    not_inlined()
    for i in range(0, rows * PANEL, ROWS * PANEL):
        _tile_plain((c_at + i, a_at + i, rows * PANEL, b_at, PANEL * PANEL, panels, PANEL), (c, a, b))


@compiled
def product_of_rows(c: Array, a: Array, panels: int, b: Array, rows: int) -> None:
    """Sum over n of a[n, o] b[n, j], shape (32 panels, 32): `a` of `panels` panels of `rows`, one panel of `b`."""
    not_inlined()
    for panel in range(panels):
        for i in range(0, PANEL, ROWS):
            a_at = panel * rows * PANEL + i
            _tile_transposed(((panel * PANEL + i) * PANEL, a_at, 0, 0, 0, 1, rows), (c, a, b))


@compiled
def padded_rows(size: int) -> int:
    """The next multiple of the rows of a tile."""
    return (size + ROWS - 1) // ROWS * ROWS
