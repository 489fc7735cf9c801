"""Adam over one line of parameters, as torch computes it."""

import math

from frasa_rl.crossq_tiles import Array, compiled
from frasa_rl.crossq_vectors import not_inlined

RATE, FIRST, SECOND, EPSILON = range(4)


@compiled
def adam(value: Array, slope: Array, first: Array, second: Array, step: float, rules: Array) -> None:
    """One step, the `step`-th (from 1).

    Args:
        value, slope, first, second: parameters, gradient and the two moments, one shape.
        rules: learning rate, the two decays, epsilon (float64: corrections are computed in it).
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
