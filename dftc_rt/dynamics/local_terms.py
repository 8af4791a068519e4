"""The split, as it runs in the loop: M_i and the torque each joint needs besides M_i q̈_i.

    inertia_i = M_i,    bias_i = C_i q̇_i + G_i + Z_i|surrogate, q̈_i = 0

so u_i = inertia_i q̈_i + bias_i is the torque of joint i if the others are where the
surrogate puts them. ``bias_i`` reads q_i and q̇_i of the measured state and nothing else
of it (with ``frozen`` and ``desired``): it is one row of a recursive Newton-Euler pass in
which joint i alone is at its measured state. M_ii depends only on the joints beyond i, not
on q_i, so one composite-rigid-body pass at the surrogate position serves every joint.

Source: [zhao2017] eq. (36).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.payload import UnitLoad
from dftc_rt.dynamics.surrogate import Interconnection, check_interconnection

Array = npt.NDArray[np.float64]


class LocalTerms:
    """Exact local terms of a URDF: n passes of RNEA and one of CRBA per update.

    Attributes:
        inertia: (n,) M_i, kg m^2, armature included; rewritten in place.
        bias: (n,) Nm; rewritten in place.
        load: (n,) Nm/kg; rewritten in place.
        interconnection: The setting.
    """

    def __init__(
        self, robot: Robot, interconnection: Interconnection, frozen_q: Array | None = None
    ) -> None:
        """Prepare the work arrays.

        Args:
            robot: The robot.
            interconnection: ``frozen``, ``desired`` or ``measured``.
            frozen_q: (n,) reference configuration of ``frozen``, rad; None: home.

        Raises:
            InputError: No such ``interconnection``.
        """
        check_interconnection(interconnection)
        n = robot.n
        self.interconnection = interconnection
        self.inertia = np.zeros(n)
        self.bias = np.zeros(n)
        self.load = np.zeros(n)
        self._unit_load = UnitLoad(robot)
        self._robot = robot
        self._model = robot.model
        self._data = robot.model.createData()
        self._tau = self._data.tau  # a view: RNEA's own return value is a copy
        self._diagonal = self._data.M.diagonal()
        self._idx_q = robot.idx_q
        self._turns = robot.continuous.tolist()
        self._x = np.zeros(robot.model.nq)
        self._v = np.zeros(n)
        self._a = np.zeros(n)
        frozen = robot.home if frozen_q is None else np.asarray(frozen_q, dtype=np.float64)
        self._frozen = np.array(frozen)
        self._frozen_inertia = pin.crba(
            self._model, self._data, robot.configuration(self._frozen)
        ).diagonal()

    def update(self, q: Array, v: Array, qd: Array, vd: Array, ad: Array) -> None:
        """Rewrite :attr:`inertia` and :attr:`bias`.

        Args:
            q: (n,) measured, rad.
            v: (n,) measured, rad/s.
            qd: (n,) desired, rad.
            vd: (n,) desired, rad/s.
            ad: (n,) desired, rad/s^2.
        """
        self._unit_load.torque(qd, vd, ad, self.load)
        if self.interconnection == "desired":
            self._set_position(qd)
            self._v[:] = vd
            self._a[:] = ad
            pin.crba(self._model, self._data, self._x)
            self.inertia[:] = self._diagonal
            self._each_joint(q, v)
        elif self.interconnection == "frozen":
            self._set_position(self._frozen)
            self._v.fill(0.0)
            self._a.fill(0.0)
            self.inertia[:] = self._frozen_inertia
            self._each_joint(q, v)
        else:
            self._set_position(q)
            pin.crba(self._model, self._data, self._x)
            self.inertia[:] = self._diagonal
            pin.rnea(self._model, self._data, self._x, v, ad)
            # RNEA is affine in q̈, and column i of M gives what q̈_i itself adds to row i.
            np.multiply(self.inertia, ad, out=self._a)
            np.subtract(self._tau, self._a, out=self.bias)

    def _set_position(self, q: Array) -> None:
        if self._robot.configuration(q, self._x) is q:
            self._x[:] = q

    def _each_joint(self, q: Array, v: Array) -> None:
        """Put one joint after the other at its measured state, and take its torque."""
        rnea, model, data, tau = pin.rnea, self._model, self._data, self._tau
        x, vs, acc, bias, turns = self._x, self._v, self._a, self.bias, self._turns
        # Python floats: a list costs less to read than an array, element by element.
        own_q, own_v = q.tolist(), v.tolist()
        others_x, others_v, others_a = x.tolist(), vs.tolist(), acc.tolist()
        for i, k in enumerate(self._idx_q):
            if turns[i]:
                x[k], x[k + 1] = math.cos(own_q[i]), math.sin(own_q[i])
            else:
                x[k] = own_q[i]
            vs[i] = own_v[i]
            acc[i] = 0.0
            rnea(model, data, x, vs, acc)
            bias[i] = tau[i]
            x[k], vs[i], acc[i] = others_x[k], others_v[i], others_a[i]
            if turns[i]:
                x[k + 1] = others_x[k + 1]
