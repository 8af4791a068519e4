"""Local terms of a closed-form plant, as they run in the loop."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dftc_rt.dynamics.closed_form.plants import ClosedForm
from dftc_rt.dynamics.surrogate import Interconnection, check_interconnection

Array = npt.NDArray[np.float64]


class ClosedFormTerms:
    """M_i and the torque each joint needs besides M_i q̈_i, in one compiled call.

    Attributes:
        inertia: (n,) M_i, kg m^2; rewritten in place.
        bias: (n,) C_i q̇_i + G_i + Z_i with q̈_i = 0, Nm; rewritten in place.
        load: (n,) zero: nothing carries a load.
        interconnection: The setting.

    Source: [zhao2017] eq. (36).
    """

    def __init__(self, form: ClosedForm, interconnection: Interconnection, frozen_q: Array) -> None:
        """Prepare the work arrays and compile.

        Args:
            form: The plant.
            interconnection: ``frozen``, ``desired`` or ``measured``.
            frozen_q: (n,) reference configuration of ``frozen``, rad.

        Raises:
            InputError: No such ``interconnection``.
        """
        check_interconnection(interconnection)
        n = form.n
        self.interconnection = interconnection
        self.inertia = np.zeros(n)
        self.bias = np.zeros(n)
        self.load = np.zeros(n)
        self._evaluate = form.local_terms
        # The kernel sees these arrays and no others: one signature, compiled here. Other
        # strides, or a read-only argument, would be compiled when they first come, in the loop.
        self._state = np.zeros((5, n))
        self._work = np.zeros((4 + n, n))
        self._q, self._v, self._sq, self._sv, self._sa = self._state
        self._sq[:] = frozen_q
        self._call()

    def update(self, q: Array, v: Array, qd: Array, vd: Array, ad: Array) -> None:
        """Rewrite :attr:`inertia` and :attr:`bias`.

        Args:
            q: (n,) measured, rad.
            v: (n,) measured, rad/s.
            qd: (n,) desired, rad.
            vd: (n,) desired, rad/s.
            ad: (n,) desired, rad/s^2.
        """
        self._q[:] = q
        self._v[:] = v
        if self.interconnection == "desired":
            self._sq[:] = qd
            self._sv[:] = vd
            self._sa[:] = ad
        elif self.interconnection == "measured":
            self._sq[:] = q
            self._sv[:] = v
            self._sa[:] = ad
        self._call()

    def _call(self) -> None:
        self._evaluate(
            self._q, self._v, self._sq, self._sv, self._sa, self._work, self.inertia, self.bias
        )
