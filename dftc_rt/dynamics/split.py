"""The split of the whole robot's dynamics into local terms and an interconnection.

    M_i q̈_i + C_i q̇_i + G_i + Z_i(q, q̇, q̈) = ρ_i u_i

This is the definition, term by term, for tests and analysis; what runs in the loop is
:mod:`dftc_rt.dynamics.local_terms`.

Source: [zhao2017] eq. (36).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from dftc_rt.dynamics.closed_form.plants import ClosedForm
from dftc_rt.dynamics.closed_form.whole_body import ClosedFormBody
from dftc_rt.dynamics.model import Robot

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SplitTerms:
    """Terms of eq. (36), one per joint.

    Attributes:
        inertia: (n,) M_i, kg m^2.
        coriolis: (n,) C_i q̇_i, Nm.
        gravity: (n,) G_i, Nm.
        interconnection: (n,) Z_i at the true state, Nm.
        expected: (n,) Z_i with the other joints at the surrogate state and q̈_i = 0, Nm:
            the part of Z_i that joint i can know.
    """

    inertia: Array
    coriolis: Array
    gravity: Array
    interconnection: Array
    expected: Array


def split(
    robot: Robot,
    q: Array,
    v: Array,
    a: Array,
    surrogate_q: Array,
    surrogate_v: Array,
    surrogate_a: Array,
) -> SplitTerms:
    """Split the dynamics at one state.

    Row i of M, C (Christoffel) and G is evaluated twice: at the true state, and with all
    joints but i at the surrogate state. M_i, C_i and G_i are the latter's own terms; Z_i is

        Z_i = Σ_{j≠i} M_ij q̈_j + [M_ii − M_i] q̈_i + Σ_{j≠i} C_ij q̇_j + [C_ii − C_i] q̇_i
              + [G_i(q) − G_i]

    A closed form has no Christoffel matrix: C_i q̇_i is what the joint's own velocity does
    with the others at rest, and Z_i all the rest.

    Args:
        robot: The robot.
        q: (n,) rad.
        v: (n,) rad/s.
        a: (n,) rad/s^2.
        surrogate_q: (n,) where the other joints are put, rad.
        surrogate_v: (n,) rad/s.
        surrogate_a: (n,) rad/s^2; enters ``expected`` only.

    Source: [zhao2017] eq. (36).
    """
    if robot.closed_form is not None:
        return _split_closed_form(robot.closed_form, q, v, a, surrogate_q, surrogate_v, surrogate_a)
    n, model, data = robot.n, robot.model, robot.model.createData()

    def rows(position: Array, velocity: Array) -> tuple[Array, Array, Array]:
        x = robot.configuration(position)
        M = pin.crba(model, data, x)
        C = pin.computeCoriolisMatrix(model, data, x, velocity)
        return M, C, pin.computeGeneralizedGravity(model, data, x)

    M, C, G = rows(q, v)
    M_i, C_v, G_i, Z, expected = np.zeros((5, n))
    for i in range(n):
        others = np.arange(n) != i
        q_i, v_i = np.where(others, surrogate_q, q), np.where(others, surrogate_v, v)
        Ms, Cs, Gs = rows(q_i, v_i)
        M_i[i], C_v[i], G_i[i] = Ms[i, i], Cs[i, i] * v[i], Gs[i]
        Z[i] = (
            M[i, others] @ a[others]
            + (M[i, i] - Ms[i, i]) * a[i]
            + C[i, others] @ v[others]
            + (C[i, i] - Cs[i, i]) * v[i]
            + (G[i] - Gs[i])
        )
        expected[i] = Ms[i, others] @ surrogate_a[others] + Cs[i, others] @ surrogate_v[others]
    return SplitTerms(M_i, C_v, G_i, Z, expected)


def _split_closed_form(
    form: ClosedForm,
    q: Array,
    v: Array,
    a: Array,
    surrogate_q: Array,
    surrogate_v: Array,
    surrogate_a: Array,
) -> SplitTerms:
    """Eq. (36) from the inverse dynamics and the mass matrix; arguments as of :func:`split`."""
    n, body, zero = form.n, ClosedFormBody(form), np.zeros(form.n)
    M, bias = body.mass_matrix(q), body.inverse_dynamics(q, v, zero)
    M_i, C_v, G_i, Z, expected = np.zeros((5, n))
    for i in range(n):
        others = np.arange(n) != i
        q_i, v_i = np.where(others, surrogate_q, q), np.where(others, surrogate_v, v)
        own_v = np.where(others, 0.0, v)
        Ms, bias_i = body.mass_matrix(q_i), body.inverse_dynamics(q_i, v_i, zero)
        G_i[i] = body.inverse_dynamics(q_i, zero, zero)[i]
        C_v[i] = body.inverse_dynamics(q_i, own_v, zero)[i] - G_i[i]
        M_i[i] = Ms[i, i]
        Z[i] = M[i, others] @ a[others] + (M[i, i] - M_i[i]) * a[i] + (bias[i] - C_v[i] - G_i[i])
        expected[i] = Ms[i, others] @ surrogate_a[others] + (bias_i[i] - C_v[i] - G_i[i])
    return SplitTerms(M_i, C_v, G_i, Z, expected)
