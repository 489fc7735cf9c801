"""A network forwards and backwards: matrix products and, beside them, one pass over the activations each way."""

from frasa_rl.crossq_net import (
    ACTIVE,
    BATCH_MEAN,
    BATCH_VAR,
    BIAS,
    FOLDED,
    IN,
    IN_PANELS,
    INVERSE,
    MIDDLE,
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
from frasa_rl.crossq_norm import fold, normalise
from frasa_rl.crossq_passes import Step, added, bias_and_rectify, masked, masked_single, product_of_one, weighted_sum
from frasa_rl.crossq_tiles import PANEL, Array, compiled, product, product_of_rows
from frasa_rl.crossq_vectors import Value, Vectors, not_inlined, over_rows


@compiled
def refold(net: Net, c: int, center: Array, rules: Array) -> None:
    """Weights for inference, good until the parameters or the running statistics change."""
    not_inlined()
    still = net.still
    for layer in range(len(net.table)):
        normalise(net, c, layer, False, center if layer == 0 else still, rules)
        fold(net, c, layer)


@compiled
def forward(net: Net, c: int, rows: int, real: int, training: bool, center: Array, rules: Array) -> None:
    """Network c on the input in `active`, of `rows` rows of which `real` count.

    In training the statistics of the input must lie in `norm`; otherwise `refold` must have been called. `center` is
    what was subtracted from the input.
    """
    not_inlined()
    count, still = len(net.table), net.still
    for layer in range(count):
        if training:
            normalise(net, c, layer, True, center if layer == 0 else still, rules)
            fold(net, c, layer)
        row = net.table[layer]
        x, y = net.active[c if layer > 0 else 0, row[ACTIVE] :], net.result[c]
        weight, bias = net.forward[c, row[PACKED] :], net.folded[c, row[FOLDED] :]
        if row[OUT] == 1:
            product_of_one(y, x, rows, real, net.backward[c, row[PACKED] :], bias[0], row[IN_PANELS])
            continue
        last = layer == count - 1
        if not last:
            y = net.active[c, net.table[layer + 1, ACTIVE] :]
        for panel in range(row[OUT_PANELS]):
            at, right = panel * rows * PANEL, panel * row[IN_PANELS] * PANEL * PANEL
            product(y, at, x, 0, rows, weight, right, row[IN_PANELS])
            here, offset = y[at : at + rows * PANEL], bias[panel * PANEL : (panel + 1) * PANEL]
            if last:
                added(real, here, offset)
            else:
                start = net.table[layer + 1, STATISTIC] + panel * PANEL
                means = net.norm[c, BATCH_MEAN, start : start + PANEL]
                bias_and_rectify(here, real, offset, means, net.norm[c, BATCH_VAR, start : start + PANEL])


@compiled
def backward(net: Net, c: int, rows: int, real: int, learning: bool, to_input: bool, room: Array) -> None:
    """From the gradient of the output in `result` to that of the parameters, or of the input.

    Args:
        learning: fill `slopes`, and follow the batch's statistics; else take running ones as given.
        to_input: leave the input's gradient in its place in `active` (added to it for c > 0).
        room: scratch, shape (3, at least 32 times the largest of rows and padded widths).
    """
    not_inlined()
    count = len(net.table)
    bias_slope, step, pull = room[0], room[1], room[2]
    for layer in range(count - 1, -1, -1):
        row = net.table[layer]
        x = net.active[c if layer > 0 else 0, row[ACTIVE] :]
        dy = net.result[c] if layer == count - 1 else net.active[c, net.table[layer + 1, ACTIVE] :]
        if layer == count - 1:
            _sum_rows(dy, rows, real, row[OUT], bias_slope)
        if learning:
            _parameter_slopes(net, c, layer, rows, real, dy, x, bias_slope, step)
        if layer > 0:
            _pass_back(net, c, layer, rows, real, learning, dy, x, bias_slope, step, pull)
        elif to_input:
            for panel in range(row[IN_PANELS]):
                weight = panel * row[OUT_PANELS] * PANEL * PANEL
                product(step, 0, dy, 0, rows, net.backward[c], row[PACKED] + weight, row[OUT_PANELS])
                here = x[panel * rows * PANEL : (panel + 1) * rows * PANEL]
                for k in range(here.size):
                    here[k] = step[k] if c == 0 else here[k] + step[k]


@compiled
def _sum_rows(dy: Array, rows: int, real: int, outputs: int, total: Array) -> None:
    """Sum over rows of the last layer's gradient: single column or panels."""
    not_inlined()
    total[:outputs] = 0
    for n in range(real):
        if outputs == 1:
            total[0] += dy[n]
        else:
            for o in range(outputs):
                total[o] += dy[(o // PANEL) * rows * PANEL + n * PANEL + o % PANEL]


@compiled
def _parameter_slopes(
    net: Net, c: int, layer: int, rows: int, real: int, dy: Array, x: Array, bias_slope: Array, raw: Array
) -> None:
    """Gradients of a layer's weight and bias and of the normalisation before it."""
    not_inlined()
    row = net.table[layer]
    inputs, outputs, start = row[IN], row[OUT], row[STATISTIC]
    slopes, values = net.slopes[c], net.values[c]
    slopes[row[BIAS] : row[BIAS] + outputs] = bias_slope[:outputs]
    for panel in range(row[IN_PANELS]):
        left = panel * PANEL
        wide = min(PANEL, inputs - left)
        here = x[left * rows : (left + PANEL) * rows]
        if outputs == 1:
            weighted_sum(real, here, dy, raw)
        else:
            product_of_rows(raw, dy, 0, row[OUT_PANELS], here, 0, rows)
        k = start + left
        arrays = (
            slopes[row[WEIGHT] + left :],
            values[row[WEIGHT] + left :],
            raw,
            bias_slope,
            net.norm[c, MIDDLE, k:],
            net.norm[c, INVERSE, k:],
            values[row[SCALE] + left :],
            values[row[SHIFT] + left :],
            slopes[row[SCALE] + left :],
            slopes[row[SHIFT] + left :],
        )
        if wide == PANEL:
            _unnormalise(outputs, inputs, arrays)
        else:
            _unnormalise_few(outputs, wide, inputs, arrays)


def _unnormal(v: Vectors, x: list[Value], slope: list[Value], constants: list[Value]) -> Step:
    """From a row of sums of dy x to that of a weight's gradient, and its part in those of scale and shift."""
    _, weight, raw = x
    middle, inverse, scale, shift = constants
    b = v.builder
    normal = b.fmul(b.fsub(raw, b.fmul(slope[0], middle)), inverse)
    new = v.product_sum(scale, normal, b.fmul(shift, slope[0]))
    return [new], [b.fmul(weight, normal), b.fmul(weight, slope[0])]


_unnormalise = over_rows(3, 2, 1, 4, 2, _unnormal)


@compiled
def _unnormalise_few(outputs: int, wide: int, stride: int, arrays: tuple[Array, ...]) -> None:
    """The same for a panel of fewer columns."""
    not_inlined()
    weight_slope, weight, raw, bias_slope, middle, inverse, scale, shift, scale_slope, shift_slope = arrays
    scale_slope[:wide], shift_slope[:wide] = 0, 0
    for o in range(outputs):
        slope, at = bias_slope[o], o * stride
        for j in range(wide):
            normal = (raw[o * PANEL + j] - slope * middle[j]) * inverse[j]
            weight_slope[at + j] = scale[j] * normal + shift[j] * slope
            scale_slope[j] += weight[at + j] * normal
            shift_slope[j] += weight[at + j] * slope


@compiled
def _pass_back(
    net: Net,
    c: int,
    layer: int,
    rows: int,
    real: int,
    learning: bool,
    dy: Array,
    x: Array,
    bias_slope: Array,
    step: Array,
    pull: Array,
) -> None:
    """Write the gradient of the linear layer before in place of x, which is its rectified output; sum it over rows.

    A normalised input's gradient g reaches the input as gain g + a + b x: a and b are how the batch's mean and variance
    answer, and need only sums of g and g x, which are the gradients of the normalisation's shift and scale.
    """
    not_inlined()
    row = net.table[layer]
    start = row[STATISTIC]
    summed = pull[2 * PANEL : 3 * PANEL]
    for panel in range(row[IN_PANELS]):
        pull[: 2 * PANEL] = 0
        if learning:
            for j in range(min(PANEL, row[IN] - panel * PANEL)):
                i = panel * PANEL + j
                norm = net.norm[c, :, start + i]
                inverse, scale = float(norm[INVERSE]), float(net.values[c, row[SCALE] + i])
                of_mean = -scale * inverse * net.slopes[c, row[SHIFT] + i]
                of_var = -0.5 * scale * inverse * inverse * net.slopes[c, row[SCALE] + i]
                of_var = of_var * norm[SHARE] - of_mean * norm[PULL]
                pull[PANEL + j] = 2.0 * of_var / (real - 1)
                pull[j] = of_mean / real - 2.0 * of_var / (real - 1) * norm[BATCH_MEAN]
        here = x[panel * rows * PANEL : (panel + 1) * rows * PANEL]
        if row[OUT] == 1:
            left = row[PACKED] + panel * PANEL
            weight = net.backward[c, left : left + PANEL]
            masked_single(real, here, dy, weight, pull[:PANEL], pull[PANEL : 2 * PANEL], summed)
        else:
            start_of = row[PACKED] + panel * row[OUT_PANELS] * PANEL * PANEL
            product(step, 0, dy, 0, rows, net.backward[c], start_of, row[OUT_PANELS])
            masked(real, here, step, pull[:PANEL], pull[PANEL : 2 * PANEL], summed)
        here[real * PANEL :] = 0
        pull[(3 + panel) * PANEL : (4 + panel) * PANEL] = summed
    bias_slope[: row[IN_PANELS] * PANEL] = pull[3 * PANEL : (3 + row[IN_PANELS]) * PANEL]
