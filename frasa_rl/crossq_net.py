"""Where the numbers of a network lie: parameters in one line, activations in panels, all of it allocated once."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from frasa_rl.crossq_tiles import ROWS
from frasa_rl.crossq_vectors import PANEL, Array

Whole = npt.NDArray[np.int64]

# Columns of a table with a row for each layer, a batch renormalisation and the linear layer after it:
# sizes; where its parameters start in the line; where its statistics start; sizes in panels; where the packed weights,
# the linear layer's bias with the normalisation in it and the panels of its input start.
IN, OUT, SCALE, SHIFT, WEIGHT, BIAS, STATISTIC, IN_PANELS, OUT_PANELS, PACKED, FOLDED, ACTIVE = range(12)

# Rows of what a batch renormalisation is in this update, a column for each input: its output is GAIN x + OFFSET, the
# normalised input (x - MIDDLE) INVERSE; BATCH_MEAN and BATCH_VAR of the input; PULL and SHARE say how the mean and the
# variance that were used follow the batch's variance. Network c has them from row NORMS c on.
GAIN, OFFSET, MIDDLE, INVERSE, BATCH_MEAN, BATCH_VAR, PULL, SHARE = range(8)
NORMS = 8


class Net(NamedTuple):
    """A network, or several of the same shape side by side (C of them).

    Attributes:
        table: one row a layer, see above, shape (L, 12).
        values, slopes, first, second: parameters, gradients and Adam's two moments, shape (C, P).
        mean, var: running statistics of the inputs of all layers, shape (C, S).
        steps: batches the statistics have seen, shape (C, L).
        radius: Frobenius norm that each layer's weight is kept at, 0 where it is free, shape (C, L).
        norm: batch renormalisation in this update, see above, shape (NORMS C, S).
        forward, backward: weights with the normalisation in them, packed for the two directions, shape (C, W).
        folded: biases with the normalisation in them, shape (C, F).
        active: inputs of all layers, in panels, shape (C, A); the first layer's are those of C = 0.
        result: output of the last layer, in panels, shape (C, panels * rows * 32); its gradient later.
        still: zeros, the centre of inputs from which nothing was subtracted, shape (S,).
    """

    table: Whole
    values: Array
    slopes: Array
    first: Array
    second: Array
    mean: Array
    var: Array
    steps: Whole
    radius: Array
    norm: Array
    forward: Array
    backward: Array
    folded: Array
    active: Array
    result: Array
    still: Array


def padded(size: int, unit: int) -> int:
    """The next multiple of `unit`."""
    return -(-size // unit) * unit


def aligned(shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Zeros that start at a cache line."""
    kind = np.dtype(dtype)
    size = int(np.prod(shape)) * kind.itemsize
    raw = np.zeros(size + 64, np.uint8)
    start = -raw.ctypes.data % 64
    return raw[start : start + size].view(kind).reshape(shape)


def table_of(widths: Sequence[int], rows: int) -> tuple[Whole, dict[str, int]]:
    """The table of a network from its input to its output, and the sizes of its arrays."""
    size = dict.fromkeys(("values", "statistics", "packed", "folded", "active"), 0)
    table = []
    for inputs, outputs in pairwise(widths):
        in_panels, out_panels = padded(inputs, PANEL) // PANEL, padded(outputs, PANEL) // PANEL
        places = []
        for count in (inputs, inputs, inputs * outputs, outputs):
            places.append(size["values"])
            size["values"] += padded(count, PANEL)
        row = [inputs, outputs, *places, size["statistics"], in_panels, out_panels]
        table.append([*row, size["packed"], size["folded"], size["active"]])
        size["statistics"] += in_panels * PANEL
        size["packed"] += in_panels * out_panels * PANEL * PANEL
        size["folded"] += out_panels * PANEL
        size["active"] += in_panels * PANEL * padded(rows, ROWS)
    return np.array(table, np.int64), size


def network(widths: Sequence[int], count: int, rows: int, dtype: npt.DTypeLike) -> Net:
    """`count` networks of these widths, for batches of at most `rows`."""
    table, size = table_of(widths, rows)
    values, statistics = (count, size["values"]), (count, size["statistics"])
    last = int(table[-1, OUT_PANELS]) * PANEL * padded(rows, ROWS)
    return Net(
        table=table,
        values=aligned(values, dtype),
        slopes=aligned(values, dtype),
        first=aligned(values, dtype),
        second=aligned(values, dtype),
        mean=aligned(statistics, dtype),
        var=aligned(statistics, dtype),
        steps=aligned((count, len(table)), np.int64),
        radius=aligned((count, len(table)), dtype),
        norm=aligned((NORMS * count, size["statistics"]), dtype),
        forward=aligned((count, size["packed"]), dtype),
        backward=aligned((count, size["packed"]), dtype),
        folded=aligned((count, size["folded"]), dtype),
        active=aligned((count, size["active"]), dtype),
        result=aligned((count, last), dtype),
        still=aligned((size["statistics"],), dtype),
    )
