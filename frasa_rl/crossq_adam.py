"""Adam over one line of parameters, as torch computes it, and the projection of weights to their first length."""

import math

import numpy as np
import numpy.typing as npt

from frasa_rl.crossq_net import IN, OUT, WEIGHT, Net
from frasa_rl.crossq_vectors import Array, compiled, line, not_inlined

RATE, FIRST, SECOND, EPSILON = range(4)


@compiled
def adam(value: Array, slope: Array, first: Array, second: Array, step: float, rules: npt.NDArray[np.float64]) -> None:
    """One step.

    Args:
        value: parameters, shape (P,).
        slope: gradient.
        first: moment.
        second: moment.
        step: which step, from 1.
        rules: learning rate, the two decays, epsilon (in double precision, as torch corrects for the start).
    """
    not_inlined()
    kind = value.dtype.type
    size = kind(rules[RATE] / (1.0 - rules[FIRST] ** step))
    root = kind(math.sqrt(1.0 - rules[SECOND] ** step))
    mix, keep, fresh = kind(1.0 - rules[FIRST]), kind(rules[SECOND]), kind(1.0 - rules[SECOND])
    epsilon = kind(rules[EPSILON])
    for i in range(value.size):
        g = slope[i]
        m = first[i] + mix * (g - first[i])
        v = keep * second[i] + fresh * g * g
        first[i], second[i] = m, v
        value[i] -= size * m / (kind(math.sqrt(v)) / root + epsilon)


@compiled
def learn(net: Net, step: float, rules: npt.NDArray[np.float64]) -> None:
    """Adam's step of networks from their gradients, and the projection of weights that have a `radius`."""
    adam(net.values.ravel(), net.slopes.ravel(), net.first.ravel(), net.second.ravel(), step, rules)
    for c in range(len(net.radius)):
        for layer in range(len(net.table)):
            if net.radius[c, layer] > 0.0:
                row = line(net.table, layer, 0)
                _project(line(net.values, c, row[WEIGHT]), row[IN] * row[OUT], net.radius[c, layer])


@compiled
def _project(weight: Array, size: int, radius: float) -> None:
    """Scale a weight to its Frobenius norm (CrossQ + WN, arXiv 2502.07523)."""
    total = 0.0
    for i in range(size):
        total += weight[i] * weight[i]
    factor = weight.dtype.type(radius / math.sqrt(total))
    for i in range(size):
        weight[i] *= factor
