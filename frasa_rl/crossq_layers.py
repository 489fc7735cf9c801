"""A network forwards: matrix products and, beside each, one pass over the activations."""

from frasa_rl.crossq_net import (
    ACTIVE,
    BATCH_MEAN,
    BATCH_VAR,
    FOLDED,
    IN_PANELS,
    NORMS,
    OUT,
    OUT_PANELS,
    PACKED,
    STATISTIC,
    Net,
)
from frasa_rl.crossq_norm import fold, normalise
from frasa_rl.crossq_passes import added, bias_and_rectify, product_of_one
from frasa_rl.crossq_tiles import product
from frasa_rl.crossq_vectors import PANEL, Array, compiled, inlined, line, not_inlined


@compiled
def refold(net: Net, c: int, center: Array, rules: Array) -> None:
    """Weights for inference, good until the parameters or the running statistics change."""
    not_inlined()
    for layer in range(len(net.table)):
        normalise(net, c, layer, False, center if layer == 0 else net.still, rules)
        fold(net, c, layer)


@compiled
def forward(net: Net, c: int, rows: int, real: int, training: bool, center: Array, rules: Array) -> None:
    """Network c on the input in `active`, of `rows` rows of which `real` count.

    In training the statistics of the input must lie in `norm`; otherwise `refold` must have been called. `center` is
    what was subtracted from the input.
    """
    not_inlined()
    for layer in range(len(net.table)):
        if training:
            normalise(net, c, layer, True, center if layer == 0 else net.still, rules)
            fold(net, c, layer)
        if net.table[layer, OUT] == 1:
            _to_one(net, c, layer, rows, real)
        else:
            _to_many(net, c, layer, rows, real)


@inlined
def _to_one(net: Net, c: int, layer: int, rows: int, real: int) -> None:
    """The last layer of a critic."""
    row = line(net.table, layer, 0)
    x, weight = line(net.active, c, row[ACTIVE]), line(net.backward, c, row[PACKED])
    product_of_one(line(net.result, c, 0), x, rows, real, weight, net.folded[c, row[FOLDED]], row[IN_PANELS])


@inlined
def _to_many(net: Net, c: int, layer: int, rows: int, real: int) -> None:
    """A hidden layer with the statistics of what comes out, or the last one of an actor."""
    row, last = line(net.table, layer, 0), layer == len(net.table) - 1
    x = line(net.active, c if layer > 0 else 0, row[ACTIVE])
    y = line(net.result, c, 0) if last else line(net.active, c, net.table[layer + 1, ACTIVE])
    weight = line(net.forward, c, row[PACKED])
    for panel in range(row[OUT_PANELS]):
        at = panel * rows * PANEL
        product(y, at, x, 0, rows, weight, panel * row[IN_PANELS] * PANEL * PANEL, row[IN_PANELS])
        bias = line(net.folded, c, row[FOLDED] + panel * PANEL)
        if last:
            added(real, y[at:], bias)
        else:
            start = net.table[layer + 1, STATISTIC] + panel * PANEL
            mean, var = (line(net.norm, NORMS * c + BATCH_MEAN, start), line(net.norm, NORMS * c + BATCH_VAR, start))
            bias_and_rectify(y[at:], real, bias, mean, var)
