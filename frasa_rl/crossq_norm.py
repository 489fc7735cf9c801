r"""Batch renormalisation (Ioffe 2017) as sb3-contrib has it, put into the weights of the linear layer that follows.

With the batch's mean m and unbiased variance v of an input x, and the running ones \mu, \nu:

.. math::
    r &= clip(\sqrt{(v + \epsilon) / (\nu + \epsilon)}, 1/3, 3), \quad
    d = clip((m - \mu) / \sqrt{\nu + \epsilon}, \pm 5) \\
    \hat x &= (x - m + d \sqrt v / r) / \sqrt{v / r^2 + \epsilon}, \qquad y = W (\gamma \hat x + \beta) + b

r = 1 and d = 0 while warming up; at inference \hat x is made of the running ones. So y is linear in x, and normalised
activations are never written: a layer reads the last one's rectified output, with weights W \gamma / \sqrt{\cdot}.
"""

from collections.abc import Callable

from frasa_rl.crossq_net import (
    BATCH_MEAN,
    BATCH_VAR,
    BIAS,
    FOLDED,
    GAIN,
    IN,
    IN_PANELS,
    INVERSE,
    MIDDLE,
    NORMS,
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
    Whole,
)
from frasa_rl.crossq_rows import Step, over_rows, transpose
from frasa_rl.crossq_vectors import PANEL, Array, Emitted, Value, Vectors, compiled, inlined, line, not_inlined

EPSILON, MOMENTUM, WARMUP = range(3)  # rows of the rules
_MOST_RATIO, _MOST_SHIFT = 3.0, 5.0  # rmax and dmax of sb3-contrib
Middle = Callable[[Vectors, list[Value], Value], tuple[Value, Value, Value, Value]]


def _running(_: Vectors, given: list[Value], __: Value) -> tuple[Value, Value, Value, Value]:
    """Mean and variance to normalise with, and how they follow the batch's variance: not at all."""
    return given[0], given[1], given[0], given[0]


def _batch(v: Vectors, given: list[Value], _: Value) -> tuple[Value, Value, Value, Value]:
    return given[2], given[3], v.zero, v.constant(1.0)


def _renormalised(v: Vectors, given: list[Value], epsilon: Value) -> tuple[Value, Value, Value, Value]:
    mean, var, batch_mean, batch_var = given
    b, one = v.builder, v.constant(1.0)
    running, root = v.root(b.fadd(var, epsilon)), v.root(batch_var)
    ratio = b.fdiv(v.root(b.fadd(batch_var, epsilon)), running)
    ratio = v.within(ratio, 1.0 / _MOST_RATIO, _MOST_RATIO)
    apart = v.within(b.fdiv(b.fsub(batch_mean, mean), running), -_MOST_SHIFT, _MOST_SHIFT)
    share = b.fdiv(one, b.fmul(ratio, ratio))
    middle = b.fsub(batch_mean, b.fdiv(b.fmul(apart, root), ratio))
    # d/dv of d sqrt(v) / r; a column that never changes (v = 0: a dead unit) pulls nothing, its gradient is masked
    pull = v.where_positive(root, b.fdiv(apart, b.fmul(v.constant(2.0), b.fmul(ratio, root))))
    return middle, b.fmul(batch_var, share), pull, share


def _normalisation(middle: Middle, training: bool) -> Emitted:
    """The pass over features: panels are mean, var, gain, offset, middle, inverse, pull, share and what they need."""

    def row(v: Vectors, x: list[Value], _: list[Value], constants: list[Value]) -> Step:
        mean, var, *_unread, batch_mean, batch_var, scale, shift, center = x
        epsilon, momentum = constants
        b = v.builder
        center_of, spread, pull, share = middle(v, [mean, var, batch_mean, batch_var], epsilon)
        inverse = b.fdiv(v.constant(1.0), v.root(b.fadd(spread, epsilon)))
        left, gain = b.fsub(center_of, center), b.fmul(scale, inverse)
        result = [gain, b.fsub(shift, b.fmul(gain, left)), left, inverse]
        if not training:
            return [None, None, *result], []
        mean = v.product_sum(momentum, b.fsub(batch_mean, mean), mean)
        var = v.product_sum(momentum, b.fsub(batch_var, var), var)
        return [mean, var, *result, pull, share], []

    return over_rows(row, panels=13, constants=2)


_inference = _normalisation(_running, training=False)
_warming = _normalisation(_batch, training=True)
_warm = _normalisation(_renormalised, training=True)


@compiled
def normalise(net: Net, c: int, layer: int, training: bool, center: Array, rules: Array) -> None:
    """Fill `norm` of a layer from the batch's statistics (training; running ones are updated) or the running ones.

    Args:
        net: networks.
        c: which of them.
        layer: of it.
        training: by the batch's statistics, which lie in `norm`.
        center: subtracted from the layer's input already, in panels.
        rules: epsilon, momentum and warm-up batches, each in a row of 32.
    """
    not_inlined()
    row, norm = line(net.table, layer, 0), NORMS * c
    start = row[STATISTIC]
    arrays = (
        line(net.mean, c, start),
        line(net.var, c, start),
        line(net.norm, norm + GAIN, start),
        line(net.norm, norm + OFFSET, start),
        line(net.norm, norm + MIDDLE, start),
        line(net.norm, norm + INVERSE, start),
        line(net.norm, norm + PULL, start),
        line(net.norm, norm + SHARE, start),
        line(net.norm, norm + BATCH_MEAN, start),
        line(net.norm, norm + BATCH_VAR, start),
        line(net.values, c, row[SCALE]),
        line(net.values, c, row[SHIFT]),
        center,
        line(rules, EPSILON, 0),
        line(rules, MOMENTUM, 0),
    )
    panels = row[IN_PANELS]
    if not training:
        _inference((panels, PANEL, PANEL), arrays)
    else:
        if net.steps[c, layer] > rules[WARMUP, 0]:
            _warm((panels, PANEL, PANEL), arrays)
        else:
            _warming((panels, PANEL, PANEL), arrays)
        net.steps[c, layer] += 1


_scaled = over_rows(lambda v, x, _, c: ([None, v.builder.fmul(x[0], c[0])], []), panels=2, far=1, constants=1)


@compiled
def fold(net: Net, c: int, layer: int) -> None:
    """Put `norm` of a layer into its weights, packed for both directions, and into its bias."""
    not_inlined()
    row = line(net.table, layer, 0)
    inputs, outputs, start = row[IN], row[OUT], row[STATISTIC]
    forward, backward = line(net.forward, c, row[PACKED]), line(net.backward, c, row[PACKED])
    high = 1 if outputs == 1 else row[OUT_PANELS] * PANEL
    _fold_bias(net, c, row)
    for left in range(0, inputs, PANEL):
        arrays = (
            line(net.values, c, row[WEIGHT] + left),
            line(net.backward, c, row[PACKED] + left * high),
            line(net.norm, NORMS * c + GAIN, start + left),
        )
        _scaled((outputs, inputs, min(PANEL, inputs - left)), arrays)
        if outputs > 1:
            for top in range(0, outputs, PANEL):
                to, at = (top * row[IN_PANELS] + left) * PANEL, left * high + top * PANEL
                transpose((to, at), (forward, backward))


@inlined
def _fold_bias(net: Net, c: int, row: Whole) -> None:
    inputs = row[IN]
    weight, offset = line(net.values, c, row[WEIGHT]), line(net.norm, NORMS * c + OFFSET, row[STATISTIC])
    for o in range(row[OUT]):
        total = net.values[c, row[BIAS] + o]
        for i in range(inputs):
            total += weight[o * inputs + i] * offset[i]
        net.folded[c, row[FOLDED] + o] = total
