"""The passes over a panel of activations, shape (rows, 32), between two matrix products; see `over_rows`."""

from frasa_rl.crossq_rows import Step, dot_rows, over_rows
from frasa_rl.crossq_vectors import PANEL, Array, Value, Vectors, compiled, not_inlined


def _rectify(v: Vectors, x: list[Value], _: list[Value], constants: list[Value]) -> Step:
    new = v.rectified(v.builder.fadd(x[0], constants[0]))
    return [new], [new]


def _apart(v: Vectors, x: list[Value], _: list[Value], constants: list[Value]) -> Step:
    difference = v.builder.fsub(x[0], constants[0])
    return [], [v.builder.fmul(difference, difference)]


def _mask(v: Vectors, x: list[Value], _: list[Value], constants: list[Value]) -> Step:
    level, factor = constants
    new = v.where_positive(x[0], v.builder.fadd(x[1], v.product_sum(factor, x[0], level)))
    return [new], [new]


def _mask_single(v: Vectors, x: list[Value], slope: list[Value], constants: list[Value]) -> Step:
    weight, level, factor = constants
    step = v.product_sum(slope[0], weight, v.product_sum(factor, x[0], level))
    new = v.where_positive(x[0], step)
    return [new], [new]


_rectified = over_rows(_rectify, panels=1, constants=1, totals=1)
_summed = over_rows(lambda _, x, __, ___: ([], [x[0]]), panels=1, totals=1)
_squared = over_rows(_apart, panels=1, constants=1, totals=1)
_added = over_rows(lambda v, x, _, c: ([v.builder.fadd(x[0], c[0])], []), panels=1, constants=1)
_moved = over_rows(lambda v, x, _, c: ([v.builder.fsub(x[0], c[0])], []), panels=1, constants=1)
_weighted = over_rows(lambda v, x, f, _: ([], [v.builder.fmul(x[0], f[0])]), panels=1, factors=1, totals=1)
_masked = over_rows(_mask, panels=2, constants=2, totals=1)
_masked_single = over_rows(_mask_single, panels=1, factors=1, constants=3, totals=1)


@compiled
def bias_and_rectify(panel: Array, real: int, bias: Array, mean: Array, var: Array) -> None:
    """max(x + bias, 0) in place, with mean and unbiased variance of what comes out."""
    not_inlined()
    _rectified((real, PANEL, PANEL), (panel, bias, mean))
    _spread(panel, real, mean, var)


@compiled
def statistics(panel: Array, real: int, mean: Array, var: Array) -> None:
    """Mean and unbiased variance of the columns."""
    not_inlined()
    _summed((real, PANEL, PANEL), (panel, mean))
    _spread(panel, real, mean, var)


@compiled
def _spread(panel: Array, real: int, mean: Array, var: Array) -> None:
    """From sums to means, and the variance about them."""
    for j in range(PANEL):
        mean[j] /= real
    _squared((real, PANEL, PANEL), (panel, mean, var))
    for j in range(PANEL):
        var[j] /= real - 1


@compiled
def added(real: int, panel: Array, bias: Array) -> None:
    """Add the bias."""
    not_inlined()
    _added((real, PANEL, PANEL), (panel, bias))


@compiled
def moved(real: int, panel: Array, center: Array) -> None:
    """Subtract the centre."""
    not_inlined()
    _moved((real, PANEL, PANEL), (panel, center))


@compiled
def product_of_one(y: Array, x: Array, rows: int, real: int, weight: Array, bias: float, panels: int) -> None:
    """The output of a layer with a single one, shape (rows,)."""
    not_inlined()
    for n in range(real):
        y[n] = bias
    dot_rows((real, panels, rows * PANEL), (y, x, weight))


@compiled
def weighted_sum(real: int, panel: Array, factor: Array, total: Array) -> None:
    """Sum of rows, each times its factor."""
    not_inlined()
    _weighted((real, PANEL, PANEL), (panel, factor, total))


@compiled
def masked(real: int, panel: Array, step: Array, level: Array, factor: Array, total: Array) -> None:
    """X becomes step + level + factor x where x is above 0 and else 0; total: its sum over rows."""
    not_inlined()
    _masked((real, PANEL, PANEL), (panel, step, level, factor, total))


@compiled
def masked_single(
    real: int, panel: Array, slope: Array, weight: Array, level: Array, factor: Array, total: Array
) -> None:
    """The same with step = slope of the row times weight of the column."""
    not_inlined()
    _masked_single((real, PANEL, PANEL), (panel, slope, weight, level, factor, total))


@compiled
def clear(array: Array, first: int, last: int) -> None:
    """Zeros in a stretch."""
    not_inlined()
    zero = array.dtype.type(0)
    for i in range(first, last):
        array[i] = zero
