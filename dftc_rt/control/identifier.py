"""The identifier (18) of one joint: copies the healthy plant from its own signals.

Its networks adapt by (21), (22) with :func:`dftc_rt.control.basis.adapt` and its bound by (23)
with :func:`dftc_rt.control.law.bound_step`, then are frozen (Remark 4 of the paper).
"""

from __future__ import annotations

from numba import njit

_CACHE = {"cache": True, "fastmath": False}
OFF = 0
ADAPT = 1
FROZEN = 2


@njit(**_CACHE)
def correction(delta_o: float, big_e: float, sgn: float, l2: float, e2o: float) -> float:
    """δ̂_o sgn(e_2o) E + l_2 e_2o, rad/s²: the terms that force x̂_2 onto x_2.

    Args:
        delta_o: δ̂_o, rad/s².
        big_e: E = 1 + |e_2o| + e_2o².
        sgn: sgn(e_2o) or its boundary layer.
        l2: l_2 > ½, 1/s.
        e2o: e_2o = x_2 - x̂_2, rad/s.

    Source: [zhao2017] eq. (18).
    """
    return delta_o * sgn * big_e + l2 * e2o


@njit(**_CACHE)
def rate1(x2o: float, l1: float, e1o: float) -> float:
    """x̂̇_1 = x̂_2 + l_1 e_1o, rad/s.

    Source: [zhao2017] eq. (18), first line; the first line of (27) too.
    """
    return x2o + l1 * e1o


@njit(**_CACHE)
def rate2(f_o: float, g_o: float, u: float, corr: float) -> float:
    """x̂̇_2 = f̂_o + ĝ_o u + correction, rad/s².

    Args:
        f_o: f̂_o(x), rad/s².
        g_o: ĝ_o(x), 1/(kg m²).
        u: Torque as applied, Nm.
        corr: From :func:`correction`.

    Source: [zhao2017] eq. (18), second line.
    """
    return f_o + g_o * u + corr
