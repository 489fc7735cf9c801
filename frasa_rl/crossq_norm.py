r"""Batch renormalisation (Ioffe 2017) as sb3-contrib has it, put into the weights of the linear layer that follows.

With the batch's mean m and unbiased variance v of an input x, and the running ones \mu, \nu:

.. math::
    r &= clip(\sqrt{(v + \epsilon) / (\nu + \epsilon)}, 1/3, 3), \quad d = clip((m - \mu) / \sqrt{\nu + \epsilon}, \pm 5) \\
    \hat x &= (x - m + d \sqrt v / r) / \sqrt{v / r^2 + \epsilon}, \qquad y = W (\gamma \hat x + \beta) + b

r = 1 and d = 0 while warming up; at inference \hat x is made of the running ones. So y is linear in x, and no normalised
activations are ever written: a layer reads the last one's rectified output, with weights W \gamma / \sqrt{\cdot}.
"""

import math

from frasa_rl.crossq_net import (
    BATCH_MEAN,
    BATCH_VAR,
    BIAS,
    FOLDED,
    GAIN,
    IN,
    INVERSE,
    MIDDLE,
    OFFSET,
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
from frasa_rl.crossq_tiles import PANEL, Array, compiled, not_inlined

_MOST_RATIO, _MOST_SHIFT = 3.0, 5.0  # rmax and dmax of sb3-contrib


@compiled
def normalise(net: Net, c: int, layer: int, training: bool, center: Array, rules: Array) -> None:
    """Fill `norm` of a layer from the batch's statistics (training; running ones are updated) or the running ones.

    Args:
        center: subtracted from the layer's input already, shape (S of the layer,); empty: nothing was.
        rules: epsilon, momentum, warm-up batches.
    """
    not_inlined()
    row, norm = net.table[layer], net.norm[c]
    start = row[STATISTIC]
    epsilon, momentum = float(rules[0]), float(rules[1])
    warm = net.steps[c, layer] > rules[2]
    for j in range(row[IN]):
        k = start + j
        mean, var = float(net.mean[c, k]), float(net.var[c, k])
        middle, spread, pull, share = mean, var, 0.0, 1.0
        if training:
            batch_mean, batch_var = float(norm[BATCH_MEAN, k]), float(norm[BATCH_VAR, k])
            middle, spread = batch_mean, batch_var
            if warm:
                running, root = math.sqrt(var + epsilon), math.sqrt(batch_var)
                ratio = min(max(math.sqrt(batch_var + epsilon) / running, 1.0 / _MOST_RATIO), _MOST_RATIO)
                moved = min(max((batch_mean - mean) / running, -_MOST_SHIFT), _MOST_SHIFT)
                middle, spread = batch_mean - moved * root / ratio, batch_var / (ratio * ratio)
                pull, share = moved / (2.0 * ratio * root) if root > 0.0 else 0.0, 1.0 / (ratio * ratio)
            net.mean[c, k] = mean + momentum * (batch_mean - mean)
            net.var[c, k] = var + momentum * (batch_var - var)
        inverse = 1.0 / math.sqrt(spread + epsilon)
        middle -= float(center[j]) if center.size > 0 else 0.0
        gain = float(net.values[c, row[SCALE] + j]) * inverse
        norm[GAIN, k], norm[OFFSET, k] = gain, float(net.values[c, row[SHIFT] + j]) - gain * middle
        norm[MIDDLE, k], norm[INVERSE, k], norm[PULL, k], norm[SHARE, k] = middle, inverse, pull, share
    if training:
        net.steps[c, layer] += 1


@compiled
def fold(net: Net, c: int, layer: int) -> None:
    """Put `norm` of a layer into its weights, packed for both directions, and into its bias."""
    not_inlined()
    row = net.table[layer]
    inputs, outputs, start = row[IN], row[OUT], row[STATISTIC]
    weight = net.values[c, row[WEIGHT] : row[WEIGHT] + inputs * outputs]
    gain, offset = net.norm[c, GAIN, start : start + inputs], net.norm[c, OFFSET, start : start + inputs]
    forward, backward = net.forward[c, row[PACKED] :], net.backward[c, row[PACKED] :]
    high = 1 if outputs == 1 else row[OUT_PANELS] * PANEL
    for o in range(outputs):
        total = net.values[c, row[BIAS] + o]
        for i in range(inputs):
            total += weight[o * inputs + i] * offset[i]
        net.folded[c, row[FOLDED] + o] = total
        for left in range(0, inputs, PANEL):
            at = (left * high) + o * PANEL
            for j in range(min(PANEL, inputs - left)):
                backward[at + j] = weight[o * inputs + left + j] * gain[left + j]
    if outputs > 1:
        _transpose(forward, backward, inputs, outputs, high)


@compiled
def _transpose(forward: Array, backward: Array, inputs: int, outputs: int, high: int) -> None:
    """Packed weights (inputs, outputs) in panels of outputs from (outputs, inputs) in panels of inputs."""
    not_inlined()
    deep = -(-inputs // PANEL) * PANEL
    for left in range(0, inputs, PANEL):
        for top in range(0, outputs, PANEL):
            for i in range(min(PANEL, inputs - left)):
                to, at = (top * deep) + (left + i) * PANEL, left * high + top * PANEL + i
                for o in range(PANEL):
                    forward[to + o] = backward[at + o * PANEL]
