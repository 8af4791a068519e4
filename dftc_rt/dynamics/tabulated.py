"""Local terms stored before the run, for a reference that is known beforehand.

Along the reference M_i is exact; the bias is a plane through its value there, touching in
the joint's own position and velocity:

    bias_i ≈ b_i + ∂b_i/∂q_i (q_i − q_id) + ∂b_i/∂q̇_i (q̇_i − q̇_id)

The remainder is of second order in the tracking error. A row is 4 n numbers, so a table
takes 32 n bytes a cycle: 4.5 MB for 20 s of 7 joints at 1 kHz, 0.8 GB for an hour.

Source: [zhao2017] eq. (36).
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.payload import UnitLoad
from dftc_rt.dynamics.select import local_terms
from dftc_rt.dynamics.surrogate import Interconnection, check_interconnection
from dftc_rt.errors import InputError

Array = npt.NDArray[np.float64]

INERTIA, CONSTANT, SLOPE_Q, SLOPE_V = range(4)
"""Rows of one entry of the table: M_i, c_i, ∂b_i/∂q_i, ∂b_i/∂q̇_i; bias_i = c_i + slopes."""


class TableError(NamedTuple):
    """Largest difference to the exact terms: inertia (n,) kg m^2, bias (n,) Nm."""

    inertia: Array
    bias: Array


@numba.njit(cache=True)
def evaluate_row(
    table: Array, k: int, q: Array, v: Array, inertia: Array, bias: Array
) -> None:  # pragma: no cover  (compiled)
    """Write the local terms of cycle ``k``; beyond the table its last row holds.

    Args:
        table: (K, 4, n) of :class:`TabulatedTerms`.
        k: Cycle, from 0.
        q: (n,) measured, rad.
        v: (n,) measured, rad/s.
        inertia: (n,) written, kg m^2.
        bias: (n,) written, Nm.
    """
    row = table[min(max(k, 0), table.shape[0] - 1)]
    for i in range(row.shape[1]):
        inertia[i] = row[0, i]
        bias[i] = row[1, i] + row[2, i] * q[i] + row[3, i] * v[i]


def refuse_closed_form(robot: Robot) -> None:
    """Refuse a robot whose derivatives Pinocchio does not know.

    Raises:
        InputError: The robot has a closed form.
    """
    if robot.closed_form is not None:
        found = f"found 'tabulated' with the closed-form plant '{robot.closed_form.name}'"
        raise InputError("control.local_terms", found, "exact")


class TabulatedTerms:
    """Local terms along a reference, to first order in each joint's own state.

    Attributes:
        motion: (K, 3, n) the reference itself: q_d, v_d, a_d of each cycle.
        table: (K, 4, n), C-contiguous, so that a cycle reads one stretch of memory.
        inertia: (n,) M_i, kg m^2; rewritten in place.
        bias: (n,) Nm; rewritten in place.
        load: (n,) Nm/kg; rewritten in place.
        interconnection: The setting.
    """

    def __init__(
        self,
        robot: Robot,
        interconnection: Interconnection,
        qd: Array,
        vd: Array,
        ad: Array,
        frozen_q: Array | None = None,
    ) -> None:
        """Evaluate the exact terms and their derivatives along the reference.

        Args:
            robot: The robot.
            interconnection: ``frozen`` or ``desired``.
            qd: (K, n) desired, rad, one row per cycle.
            vd: (K, n) rad/s.
            ad: (K, n) rad/s^2.
            frozen_q: (n,) reference configuration of ``frozen``, rad; None: home.

        Raises:
            InputError: ``measured``, which is not known beforehand, a closed-form plant, or
                arrays of different or empty shapes.
        """
        check_interconnection(interconnection)
        refuse_closed_form(robot)
        if interconnection == "measured":
            what = "found 'measured', which no table can hold"
            raise InputError("control.interconnection", what, "frozen or desired")
        qd, vd, ad = (np.ascontiguousarray(x, dtype=np.float64) for x in (qd, vd, ad))
        shape = (len(qd), robot.n)
        if not len(qd) or any(x.shape != shape for x in (qd, vd, ad)):
            found = f"found shapes {qd.shape}, {vd.shape}, {ad.shape}"
            raise InputError("reference", found, f"(K, {robot.n}) three times, K from 1")
        self.interconnection = interconnection
        self.inertia = np.zeros(robot.n)
        self.bias = np.zeros(robot.n)
        self.load = np.zeros(robot.n)
        self._loads = np.zeros(shape)
        unit = UnitLoad(robot)
        for k in range(len(qd)):
            unit.torque(qd[k], vd[k], ad[k], self._loads[k])
        self._exact = local_terms(robot, interconnection, frozen_q)
        self._reference = qd, vd, ad
        self.motion = np.stack((qd, vd, ad), axis=1)
        if interconnection == "desired":
            self.table = _along_desired(robot, qd, vd, ad)
        else:
            frozen = robot.home if frozen_q is None else np.asarray(frozen_q, dtype=np.float64)
            self.table = _around_frozen(robot, frozen, qd, vd)
        _shift_to_zero(self.table, qd, vd)
        if robot.friction is not None:
            for row, v in zip(self.table, vd, strict=True):
                robot.friction.add_to(row[CONSTANT], v)
        evaluate_row(self.table, 0, qd[0], vd[0], self.inertia, self.bias)  # compiles

    def update(self, k: int, q: Array, v: Array) -> None:
        """Rewrite :attr:`inertia` and :attr:`bias` for cycle ``k``.

        Args:
            k: Cycle, from 0; beyond the table its last row holds.
            q: (n,) measured, rad.
            v: (n,) measured, rad/s.
        """
        evaluate_row(self.table, k, q, v, self.inertia, self.bias)
        self.load[:] = self._loads[min(max(k, 0), len(self._loads) - 1)]

    def error(
        self, offset_q: float, offset_v: float, samples: int = 200, seed: int = 0
    ) -> TableError:
        """Compare with the exact terms at random cycles, off the reference.

        Args:
            offset_q: Largest distance of each joint from the reference, rad.
            offset_v: The same in velocity, rad/s.
            samples: How many cycles.
            seed: Of the random cycles and offsets.
        """
        qd, vd, ad = self._reference
        rng = np.random.default_rng(seed)
        inertia, bias = np.zeros((2, qd.shape[1]))
        for k in rng.integers(0, len(qd), samples):
            q = qd[k] + offset_q * rng.uniform(-1.0, 1.0, qd.shape[1])
            v = vd[k] + offset_v * rng.uniform(-1.0, 1.0, qd.shape[1])
            self.update(int(k), q, v)
            self._exact.update(q, v, qd[k], vd[k], ad[k])
            np.maximum(inertia, np.abs(self.inertia - self._exact.inertia), out=inertia)
            np.maximum(bias, np.abs(self.bias - self._exact.bias), out=bias)
        return TableError(inertia, bias)


def _along_desired(robot: Robot, qd: Array, vd: Array, ad: Array) -> Array:
    """One derivative pass per cycle: at the reference all joints are at the surrogate.

    M_ii does not depend on q_i, so ∂/∂q_i is the same with q̈_i = 0 and with q̈_i = q̈_id.
    """
    model, data = robot.model, robot.model.createData()
    table = np.empty((len(qd), 4, robot.n))
    x = np.empty(model.nq)
    for row, q, v, a in zip(table, qd, vd, ad, strict=True):
        dq, dv, M = pin.computeRNEADerivatives(model, data, robot.configuration(q, x), v, a)
        row[INERTIA] = M.diagonal()
        row[CONSTANT] = data.tau - row[INERTIA] * a
        row[SLOPE_Q] = dq.diagonal()
        row[SLOPE_V] = dv.diagonal()
    return table


def _around_frozen(robot: Robot, frozen: Array, qd: Array, vd: Array) -> Array:
    """One derivative pass per cycle and joint, the other joints frozen."""
    n, model, data = robot.n, robot.model, robot.model.createData()
    table = np.empty((len(qd), 4, n))
    table[:, INERTIA] = pin.crba(model, data, robot.configuration(frozen)).diagonal()
    zero, x = np.zeros(n), np.empty(model.nq)
    q, v = frozen.copy(), np.zeros(n)
    for k, row in enumerate(table):
        for i in range(n):
            q[i], v[i] = qd[k, i], vd[k, i]
            dq, dv, _ = pin.computeRNEADerivatives(model, data, robot.configuration(q, x), v, zero)
            row[CONSTANT, i], row[SLOPE_Q, i], row[SLOPE_V, i] = data.tau[i], dq[i, i], dv[i, i]
            q[i], v[i] = frozen[i], 0.0
    return table


def _shift_to_zero(table: Array, qd: Array, vd: Array) -> None:
    """Make CONSTANT the plane's value at q_i = q̇_i = 0, so that no row needs its reference."""
    table[:, CONSTANT] -= table[:, SLOPE_Q] * qd + table[:, SLOPE_V] * vd
