"""Branch-free sin, 2^x and log2 that a compiler turns into vector instructions.

The library's own functions are calls, and a loop with a call in it stays scalar. Relative
errors are below 1e-11 (a test holds them against numpy), far below an encoder count. Products
are fused with sums by name, never at the compiler's choice, so that a number does not depend on
what stands around it in a loop. Polynomials are summed in pairs, not one coefficient after
another: a simulation step waits for every result.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

_LN2 = math.log(2.0)
_ROOT_HALF_BITS = 0x3FE6A09E667F3BCD  # of sqrt(1/2): mantissas are taken from [sqrt(1/2), sqrt(2))
_ROUND = 1.5 * 2.0**52  # added to a number and taken away it rounds it; between, the last bits are the integer


def _series(function: Callable[[Any], Any], degree: int, low: float, high: float) -> tuple[float, ...]:
    """Coefficients, lowest first, of the polynomial through a function at Chebyshev's points."""
    fitted = np.polynomial.Chebyshev.interpolate(function, degree, (low, high))
    return tuple(float(one) for one in fitted.convert(kind=np.polynomial.Polynomial).coef)


# (sin(x) / x - 1) / x^2, 2^x, and log2((1 + x) / (1 - x)) / x less its start; the first and the last of x^2.
# Intervals end where the nearest multiple, power or exponent changes, and start where no zero is divided by zero.
_SIN = _series(lambda z: (np.sin(np.sqrt(z)) / np.sqrt(z) - 1.0) / z, 6, 1e-2, (math.pi / 2.0) ** 2)
_EXP2 = _series(np.exp2, 9, -0.5, 0.5)
_LOG2 = _series(lambda z: 2.0 / _LN2 * np.arctanh(np.sqrt(z)) / np.sqrt(z), 5, 1e-6, 0.0295)


def _bits_of(context: Any, x: Any) -> Any:  # noqa: ANN401 (numba's own protocol)
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
        return builder.bitcast(args[0], ir.IntType(64))

    return types.int64(types.float64), generate


def _float_of(context: Any, x: Any) -> Any:  # noqa: ANN401
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
        return builder.bitcast(args[0], ir.DoubleType())

    return types.float64(types.int64), generate


def _fused(context: Any, x: Any, y: Any, z: Any) -> Any:  # noqa: ANN401
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), generate


# The 64 bits of a float as an integer, and back; x y + z rounded once.
_compiled: Any = intrinsic
_bits: Callable[[float], int] = _compiled(_bits_of)
_float: Callable[[int], float] = _compiled(_float_of)
fma: Callable[[float, float, float], float] = _compiled(_fused)


@njit(inline="always")
def fast_sin(x: float) -> float:
    """sin(x) for angles of up to some thousand turns, by the nearest multiple of pi."""
    shifted = fma(x, 1.0 / math.pi, _ROUND)
    r = fma(_ROUND - shifted, math.pi, x)
    z = r * r
    square = z * z
    high = fma(square, _SIN[6], fma(z, _SIN[5], _SIN[4]))
    low = fma(square, fma(z, _SIN[3], _SIN[2]), fma(z, _SIN[1], _SIN[0]))
    p = fma(square * square, high, low)
    # Odd multiples change the sign.
    return _float(_bits(fma(r * z, p, r)) ^ (_bits(shifted) << 63))


@njit(inline="always")
def fast_exp2(x: float) -> float:
    """2^x, clipped to exponents within +-1000."""
    x = min(max(x, -1000.0), 1000.0)
    shifted = x + _ROUND
    f = x - (shifted - _ROUND)
    square = f * f
    fourth = square * square
    high = fma(square, fma(f, _EXP2[7], _EXP2[6]), fma(f, _EXP2[5], _EXP2[4]))
    low = fma(square, fma(f, _EXP2[3], _EXP2[2]), fma(f, _EXP2[1], _EXP2[0]))
    p = fma(fourth * fourth, fma(f, _EXP2[9], _EXP2[8]), fma(fourth, high, low))
    return _float(_bits(p) + (_bits(shifted) << 52))


@njit(inline="always")
def fast_log2(x: float) -> float:
    """log2(x) of a positive number, that of 1e-300 below it; by the odd series about one."""
    bits = _bits(max(x, 1e-300))
    exponent = (bits - _ROOT_HALF_BITS) >> 52
    m = _float(bits - (exponent << 52))
    t = (m - 1.0) / (m + 1.0)
    z = t * t
    square = z * z
    low = fma(square, fma(z, _LOG2[3], _LOG2[2]), fma(z, _LOG2[1], _LOG2[0]))
    p = fma(square * square, fma(z, _LOG2[5], _LOG2[4]), low)
    return fma(t, p, np.float64(exponent))
