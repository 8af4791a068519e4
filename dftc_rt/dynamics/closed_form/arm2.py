"""Example 2: the 2-DOF reconfigurable manipulator, angles from the upright.

The printed C is not the Christoffel matrix, so Ṁ - 2C is not skew-symmetric, but C q̇ is that
of a planar arm of two equal links; ``robots/arm2`` is that arm as a URDF.

Source: [zhao2017] eq. (35).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@njit(cache=True)
def mass_matrix(q: F64, out: F64) -> None:
    """M (2, 2), kg m², at q (2,), rad.

    Source: [zhao2017] eq. (35).
    """
    c2 = math.cos(q[1])
    out[0, 0] = 0.36 * c2 + 0.6066
    out[0, 1] = out[1, 0] = 0.18 * c2 + 0.1233
    out[1, 1] = 0.1233


@njit(cache=True)
def bias(q: F64, v: F64, out: F64) -> None:
    """C(q, q̇) q̇ + G(q), (2,), Nm, with the printed C.

    Args:
        q: (2,), rad.
        v: (2,), rad/s.
        out: (2,), Nm, written.

    Source: [zhao2017] eq. (35).
    """
    s2 = math.sin(q[1])
    c11, c12 = -0.36 * s2 * v[1], -0.18 * s2 * v[1]
    c21, c22 = 0.18 * s2 * (v[0] - v[1]), 0.18 * s2 * v[0]
    weight = -5.88 * math.sin(q[0] + q[1])
    out[0] = c11 * v[0] + c12 * v[1] + weight - 17.64 * math.sin(q[0])
    out[1] = c21 * v[0] + c22 * v[1] + weight


@njit(cache=True)
def inverse_dynamics(q: F64, v: F64, a: F64, out: F64) -> None:
    """Torque (2,), Nm, at q (2,) rad, v (2,) rad/s and a (2,) rad/s²; written to ``out``."""
    bias(q, v, out)
    c2 = math.cos(q[1])
    m12 = 0.18 * c2 + 0.1233
    out[0] += (0.36 * c2 + 0.6066) * a[0] + m12 * a[1]
    out[1] += m12 * a[0] + 0.1233 * a[1]


@njit(cache=True)
def forward_dynamics(q: F64, v: F64, tau: F64, out: F64) -> None:
    """Acceleration (2,), rad/s², under the torque ``tau`` (2,), Nm; written to ``out``."""
    bias(q, v, out)
    b0, b1 = tau[0] - out[0], tau[1] - out[1]
    c2 = math.cos(q[1])
    m11, m12, m22 = 0.36 * c2 + 0.6066, 0.18 * c2 + 0.1233, 0.1233
    det = m11 * m22 - m12 * m12
    out[0] = (m22 * b0 - m12 * b1) / det
    out[1] = (m11 * b1 - m12 * b0) / det
