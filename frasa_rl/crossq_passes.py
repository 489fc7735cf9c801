"""The passes over a panel of activations, shape (rows, 32), between two matrix products; see `over_rows`."""

from frasa_rl.crossq_tiles import Array, compiled
from frasa_rl.crossq_vectors import PANEL, Value, Vectors, not_inlined, over_rows

_Step = tuple[Value | None, list[Value]]


def _rectify(v: Vectors, x: list[Value], _: list[Value], constants: list[Value]) -> _Step:
    new = v.rectified(v.builder.fadd(x[0], constants[0]))
    return new, [new]


def _apart(v: Vectors, x: list[Value], _: list[Value], constants: list[Value]) -> _Step:
    difference = v.builder.fsub(x[0], constants[0])
    return None, [v.builder.fmul(difference, difference)]


def _mask(v: Vectors, x: list[Value], _: list[Value], constants: list[Value]) -> _Step:
    level, factor = constants
    new = v.where_positive(x[0], v.builder.fadd(x[1], v.product_sum(factor, x[0], level)))
    return new, [new]


def _mask_single(v: Vectors, x: list[Value], slope: list[Value], constants: list[Value]) -> _Step:
    weight, level, factor = constants
    step = v.product_sum(slope[0], weight, v.product_sum(factor, x[0], level))
    new = v.where_positive(x[0], step)
    return new, [new]


_rectified = over_rows(panels=1, factors=0, constants=1, totals=1, row=_rectify)
_summed = over_rows(panels=1, factors=0, constants=0, totals=1, row=lambda _, x, __, ___: (None, [x[0]]))
_squared = over_rows(panels=1, factors=0, constants=1, totals=1, row=_apart)
_moved = over_rows(panels=1, factors=0, constants=1, totals=0, row=lambda v, x, _, c: (v.builder.fsub(x[0], c[0]), []))
_weighted = over_rows(
    panels=1, factors=1, constants=0, totals=1, row=lambda v, x, f, _: (None, [v.builder.fmul(x[0], f[0])])
)
_masked = over_rows(panels=2, factors=0, constants=2, totals=1, row=_mask)
_masked_single = over_rows(panels=1, factors=1, constants=3, totals=1, row=_mask_single)


@compiled
def bias_and_rectify(panel: Array, real: int, bias: Array, mean: Array, var: Array) -> None:
    """max(x + bias, 0) in place, with mean and unbiased variance of what comes out."""
    not_inlined()
    _rectified(real, (panel, bias, mean))
    _spread(panel, real, mean, var)


@compiled
def statistics(panel: Array, real: int, mean: Array, var: Array) -> None:
    """Mean and unbiased variance of the columns."""
    not_inlined()
    _summed(real, (panel, mean))
    _spread(panel, real, mean, var)


@compiled
def _spread(panel: Array, real: int, mean: Array, var: Array) -> None:
    """From sums to means, and the variance about them."""
    for j in range(PANEL):
        mean[j] /= real
    _squared(real, (panel, mean, var))
    for j in range(PANEL):
        var[j] /= real - 1


@compiled
def moved(real: int, panel: Array, center: Array) -> None:
    """Subtract the centre."""
    not_inlined()
    _moved(real, (panel, center))


@compiled
def weighted_sum(real: int, panel: Array, factor: Array, total: Array) -> None:
    """Sum of rows, each times its factor."""
    not_inlined()
    _weighted(real, (panel, factor, total))


@compiled
def masked(real: int, panel: Array, step: Array, level: Array, factor: Array, total: Array) -> None:
    """X becomes step + level + factor x where x is above 0 and else 0; total: its sum over rows."""
    not_inlined()
    _masked(real, (panel, step, level, factor, total))


@compiled
def masked_single(
    real: int, panel: Array, slope: Array, weight: Array, level: Array, factor: Array, total: Array
) -> None:
    """The same with step = slope of the row times weight of the column."""
    not_inlined()
    _masked_single(real, (panel, slope, weight, level, factor, total))
