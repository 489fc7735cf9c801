"""A network backwards, by hand: gradients of parameters or of the input from that of the output."""

from frasa_rl.crossq_net import (
    ACTIVE,
    BATCH_MEAN,
    BIAS,
    IN,
    IN_PANELS,
    INVERSE,
    MIDDLE,
    NORMS,
    OUT,
    OUT_PANELS,
    PACKED,
    PULL,
    SCALE,
    SHARE,
    SHIFT,
    STATISTIC,
    WEIGHT,
    Net,
)
from frasa_rl.crossq_passes import clear, masked, masked_single, weighted_sum
from frasa_rl.crossq_rows import Step, over_rows
from frasa_rl.crossq_tiles import product, product_of_rows
from frasa_rl.crossq_vectors import PANEL, Array, Value, Vectors, compiled, inlined, line, not_inlined

BIAS_SLOPE, STEP, LEVEL, FACTOR, SUMMED, SHARES, ROOMS = range(7)  # rows of the scratch


@compiled
def backward(net: Net, c: int, rows: int, real: int, learning: bool, to_input: bool, room: Array) -> None:
    """From the gradient of the output in `result` to that of the parameters, or of the input.

    Args:
        net: networks.
        c: which of them.
        rows: of a panel.
        real: rows that count.
        learning: fill `slopes`, and follow the batch's statistics; else take running ones as given.
        to_input: leave the input's gradient in its place in `active` (added to it for c > 0).
        room: scratch, shape (ROOMS, at least 32 times the larger of rows and padded widths).
    """
    not_inlined()
    count = len(net.table)
    _sum_rows(line(net.result, c, 0), rows, real, net.table[count - 1, OUT], line(room, BIAS_SLOPE, 0))
    for layer in range(count - 1, -1, -1):
        dy = line(net.result, c, 0) if layer == count - 1 else line(net.active, c, net.table[layer + 1, ACTIVE])
        x = line(net.active, c if layer > 0 else 0, net.table[layer, ACTIVE])
        if learning:
            _parameter_slopes(net, c, layer, rows, real, dy, x, room)
        if layer > 0:
            _pass_back(net, c, layer, rows, real, learning, dy, x, room)
        elif to_input:
            _to_input(net, c, rows, dy, x, line(room, STEP, 0))


@compiled
def _sum_rows(dy: Array, rows: int, real: int, outputs: int, total: Array) -> None:
    """Sum over rows of the last layer's gradient: a single column, or panels."""
    not_inlined()
    clear(total, 0, outputs)
    for n in range(real):
        if outputs == 1:
            total[0] += dy[n]
        else:
            for o in range(outputs):
                total[o] += dy[(o // PANEL) * rows * PANEL + n * PANEL + o % PANEL]


def _unnormal(v: Vectors, x: list[Value], slope: list[Value], constants: list[Value]) -> Step:
    """From a row of sums of dy x to that of a weight's gradient, and its part in those of scale and shift."""
    _, weight, raw = x
    middle, inverse, scale, shift = constants
    b = v.builder
    normal = b.fmul(b.fsub(raw, b.fmul(slope[0], middle)), inverse)
    new = v.product_sum(scale, normal, b.fmul(shift, slope[0]))
    return [new], [b.fmul(weight, normal), b.fmul(weight, slope[0])]


_unnormalised = over_rows(_unnormal, panels=3, far=2, factors=1, constants=4, totals=2)


@inlined
def _parameter_slopes(net: Net, c: int, layer: int, rows: int, real: int, dy: Array, x: Array, room: Array) -> None:
    """Gradients of a layer's weight and bias and of the normalisation before it."""
    row, norm = line(net.table, layer, 0), NORMS * c
    inputs, outputs, raw, bias_slope = row[IN], row[OUT], line(room, STEP, 0), line(room, BIAS_SLOPE, 0)
    to = line(net.slopes, c, row[BIAS])
    for o in range(outputs):
        to[o] = bias_slope[o]
    for left in range(0, inputs, PANEL):
        here, k = x[left * rows :], row[STATISTIC] + left
        if outputs == 1:
            weighted_sum(real, here, dy, raw)
        else:
            product_of_rows(raw, dy, row[OUT_PANELS], here, rows)
        arrays = (
            line(net.slopes, c, row[WEIGHT] + left),
            line(net.values, c, row[WEIGHT] + left),
            raw,
            bias_slope,
            line(net.norm, norm + MIDDLE, k),
            line(net.norm, norm + INVERSE, k),
            line(net.values, c, row[SCALE] + left),
            line(net.values, c, row[SHIFT] + left),
            line(net.slopes, c, row[SCALE] + left),
            line(net.slopes, c, row[SHIFT] + left),
        )
        _unnormalised((outputs, inputs, min(PANEL, inputs - left)), arrays)


def _answer(v: Vectors, x: list[Value], _: list[Value], constants: list[Value]) -> Step:
    """How the batch's mean and variance answer, as a level and a factor of x; see `_pass_back`."""
    _, _, inverse, scale, scale_slope, shift_slope, pull, share, mean = x
    one, two = constants  # 1 / rows, 2 / (rows - 1)
    b = v.builder
    slope = b.fmul(scale, inverse)
    of_mean = b.fsub(v.zero, b.fmul(slope, shift_slope))
    of_var = b.fmul(b.fmul(v.constant(-0.5), b.fmul(slope, inverse)), b.fmul(scale_slope, share))
    factor = b.fmul(two, b.fsub(of_var, b.fmul(of_mean, pull)))
    return [b.fsub(b.fmul(of_mean, one), b.fmul(factor, mean)), factor], []


_answered = over_rows(_answer, panels=9, constants=2)


@inlined
def _levels(net: Net, c: int, layer: int, real: int, room: Array) -> None:
    row, norm, share = line(net.table, layer, 0), NORMS * c, line(room, SHARES, 0)
    start = row[STATISTIC]
    for j in range(PANEL):
        share[j], share[PANEL + j] = 1.0 / real, 2.0 / (real - 1)
    arrays = (
        line(room, LEVEL, 0),
        line(room, FACTOR, 0),
        line(net.norm, norm + INVERSE, start),
        line(net.values, c, row[SCALE]),
        line(net.slopes, c, row[SCALE]),
        line(net.slopes, c, row[SHIFT]),
        line(net.norm, norm + PULL, start),
        line(net.norm, norm + SHARE, start),
        line(net.norm, norm + BATCH_MEAN, start),
        share,
        line(room, SHARES, PANEL),
    )
    _answered((row[IN_PANELS], PANEL, PANEL), arrays)


@inlined
def _pass_back(
    net: Net, c: int, layer: int, rows: int, real: int, learning: bool, dy: Array, x: Array, room: Array
) -> None:
    """Write the gradient of the linear layer before in place of x, which is its rectified output; sum it over rows.

    A normalised input's gradient g reaches the input as gain g + a + b x: a and b are how the batch's mean and variance
    answer, and need only sums of g and g x, which are the gradients of the normalisation's shift and scale.
    """
    row, weight, step = line(net.table, layer, 0), line(net.backward, c, net.table[layer, PACKED]), line(room, STEP, 0)
    panels, wide = row[IN_PANELS], row[OUT_PANELS] * PANEL * PANEL
    if learning:
        _levels(net, c, layer, real, room)
    else:
        clear(line(room, LEVEL, 0), 0, panels * PANEL)
        clear(line(room, FACTOR, 0), 0, panels * PANEL)
    for panel in range(panels):
        here, left = x[panel * rows * PANEL :], panel * PANEL
        level, factor, summed = line(room, LEVEL, left), line(room, FACTOR, left), line(room, SUMMED, left)
        if row[OUT] == 1:
            masked_single(real, here, dy, weight[left:], level, factor, summed)
        else:
            product(step, 0, dy, 0, rows, weight, panel * wide, row[OUT_PANELS])
            masked(real, here, step, level, factor, summed)
        clear(here, real * PANEL, rows * PANEL)
    for j in range(panels * PANEL):
        room[BIAS_SLOPE, j] = room[SUMMED, j]


@inlined
def _to_input(net: Net, c: int, rows: int, dy: Array, x: Array, step: Array) -> None:
    """The gradient of the input, in its place; of several networks their sum."""
    row, weight = line(net.table, 0, 0), line(net.backward, c, 0)
    for panel in range(row[IN_PANELS]):
        at = row[PACKED] + panel * row[OUT_PANELS] * PANEL * PANEL
        product(step, 0, dy, 0, rows, weight, at, row[OUT_PANELS])
        start = panel * rows * PANEL
        if c == 0:
            clear(x, start, start + rows * PANEL)
        for k in range(rows * PANEL):
            x[start + k] += step[k]
