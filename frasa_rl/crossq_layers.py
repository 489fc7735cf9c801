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
from frasa_rl.crossq_passes import bias_and_rectify, masked, masked_single, statistics, weighted_sum
from frasa_rl.crossq_tiles import PANEL, Array, compiled, not_inlined, product, product_of_rows


@compiled
def refold(net: Net, c: int, center: Array, rules: Array) -> None:
    """Weights for inference, good until the parameters or the running statistics change."""
    not_inlined()
    for layer in range(len(net.table)):
        normalise(net, c, layer, False, center if layer == 0 else center[:0], rules)
        fold(net, c, layer)


@compiled
def forward(net: Net, c: int, rows: int, real: int, training: bool, center: Array, rules: Array) -> None:
    """Network c on the input in `active`, of `rows` rows of which `real` count.

    In training the statistics of the input must lie in `norm`; otherwise `refold` must have been called. `center` is
    what was subtracted from the input.
    """
    not_inlined()
    count = len(net.table)
    for layer in range(count):
        if training:
            normalise(net, c, layer, True, center if layer == 0 else center[:0], rules)
            fold(net, c, layer)
        row = net.table[layer]
        x, y = net.active[c if layer > 0 else 0, row[ACTIVE] :], net.result[c]
        weight, bias = net.forward[c, row[PACKED] :], net.folded[c, row[FOLDED] :]
        if row[OUT] == 1:
            _product_of_one(y, x, rows, real, net.backward[c, row[PACKED] :], bias[0], row[IN_PANELS])
            continue
        last = layer == count - 1
        if not last:
            y = net.active[c, net.table[layer + 1, ACTIVE] :]
        for panel in range(row[OUT_PANELS]):
            at, right = panel * rows * PANEL, panel * row[IN_PANELS] * PANEL * PANEL
            product(y, at, x, 0, rows, weight, right, row[IN_PANELS])
            here, offset = y[at : at + rows * PANEL], bias[panel * PANEL : (panel + 1) * PANEL]
            if last:
                _add(here, offset)
            else:
                start = net.table[layer + 1, STATISTIC] + panel * PANEL
                means = net.norm[c, BATCH_MEAN, start : start + PANEL]
                bias_and_rectify(here, real, offset, means, net.norm[c, BATCH_VAR, start : start + PANEL])


@compiled
def _product_of_one(y: Array, x: Array, rows: int, real: int, weight: Array, bias: float, panels: int) -> None:
    """The output of a layer with a single one, shape (rows,)."""
    not_inlined()
    for n in range(real):
        y[n] = bias
    for panel in range(panels):
        here, w = x[panel * rows * PANEL :], weight[panel * PANEL : (panel + 1) * PANEL]
        for n in range(real):
            total = y[n]
            for j in range(PANEL):
                total += here[n * PANEL + j] * w[j]
            y[n] = total


@compiled
def _add(panel: Array, bias: Array) -> None:
    not_inlined()
    for n in range(0, panel.size, PANEL):
        for j in range(PANEL):
            panel[n + j] += bias[j]


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
        _unnormalised(
            raw,
            bias_slope,
            outputs,
            wide,
            inputs,
            net.norm[c, MIDDLE, k : k + wide],
            net.norm[c, INVERSE, k : k + wide],
            values[row[SCALE] + left : row[SCALE] + left + wide],
            values[row[SHIFT] + left : row[SHIFT] + left + wide],
            values[row[WEIGHT] + left :],
            slopes[row[WEIGHT] + left :],
            slopes[row[SCALE] + left : row[SCALE] + left + wide],
            slopes[row[SHIFT] + left : row[SHIFT] + left + wide],
        )


@compiled
def _unnormalised(
    raw: Array,
    bias_slope: Array,
    outputs: int,
    wide: int,
    stride: int,
    middle: Array,
    inverse: Array,
    scale: Array,
    shift: Array,
    weight: Array,
    weight_slope: Array,
    scale_slope: Array,
    shift_slope: Array,
) -> None:
    """From sums of dy x (raw, shape (outputs, 32)) to gradients of weight, scale and shift."""
    not_inlined()
    scale_slope[:], shift_slope[:] = 0, 0
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
