"""B4: the law ``dftc`` that is told the true ρ, the most that fault tolerance can give."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dftc_rt.control.baselines.base import Effectiveness
from dftc_rt.control.dftc import Dftc
from dftc_rt.control.interface import F64
from dftc_rt.control.layout import Joints
from dftc_rt.control.settings import Value
from dftc_rt.control.signals import (
    ACTUATOR_LOSS,
    HEALTHY,
    OBSERVABLE,
    RHO_HAT,
    RHO_STD,
    VERDICT,
)


class Oracle:
    """``dftc`` with the gain 1/ρ of the true ρ, at once and without a decision.

    The gain takes ρ in the middle of the period in which the command acts; the record has that
    of this cycle, and a loss as the verdict while it is below ``rho_clear``. A simulation only:
    on a robot nobody knows ρ, and a gain for a fault that is not there is dangerous.

    Attributes:
        ftc: Whether the gain is applied; the true ρ is logged in any case.
        uses_local_terms: As of ``dftc``.
        law: The law ``dftc`` inside; its own estimate runs on and is not used.
    """

    def __init__(
        self,
        joints: Joints,
        gains: Mapping[str, Value],
        effectiveness: Effectiveness,
        *,
        ftc: bool,
    ) -> None:
        """Allocate the law.

        Args:
            joints: Robot and drives.
            gains: Keys of :data:`dftc_rt.control.settings.NAMES`.
            effectiveness: True ρ over time.
            ftc: Whether the gain is applied.

        Raises:
            InputError: A gain is unknown or out of bounds.
        """
        # A gain that may not follow stays where it is put: that of the last line of the kernel's
        # gain stage is then ours, and saturation, adaptation and estimators see it.
        self.law = Dftc(joints, {**gains, "gain_rate": 0.0}, ftc=False)
        self.ftc = ftc
        self.uses_local_terms = self.law.uses_local_terms
        self._effectiveness = effectiveness
        parameters = self.law.storage.parameters
        self._least: F64 = parameters["rho_min"].copy()
        self._clear: F64 = parameters["rho_clear"].copy()
        self._largest: F64 = parameters["rho_max"].copy()
        self._period = joints.period_s
        self._ahead = (joints.delay_cycles + 0.5) * joints.period_s
        self._delays = [float(ahead) for ahead in np.unique(self._ahead)]
        self._ticks = 0
        self._rho = np.ones(joints.torque_limit.shape[0])
        self._gain = np.ones_like(self._rho)

    def start(self, q: F64, v: F64) -> None:
        """Reset every state and the clock.

        Raises:
            InputError: A shape is wrong or a value is not finite.
        """
        self.law.start(q, v)
        self._ticks = 0

    def skip(self, ticks: int) -> None:
        """Ticks without a cycle, see :class:`dftc_rt.control.interface.Law`."""
        self.law.skip(ticks)
        self._ticks += ticks

    def told(self, joint: int, tau: float) -> None:
        """Another command was sent, see :class:`dftc_rt.control.interface.Law`."""
        self.law.told(joint, tau)

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """One cycle, see :class:`dftc_rt.control.interface.Law`."""
        now, rho = self._ticks * self._period, self._rho
        if self.ftc:
            for ahead in self._delays:
                self._effectiveness(now + ahead, rho)
                np.copyto(self._gain, 1.0 / np.clip(rho, self._least, self._largest),
                          where=self._ahead == ahead)  # fmt: skip
            self.law.storage.state["gain"] = self._gain
        self._effectiveness(now, rho)
        self._ticks += 1
        status = self.law.update(rec, inertia, bias)
        rec[RHO_HAT] = rho
        rec[RHO_STD] = 0.0
        rec[OBSERVABLE] = 1.0
        rec[VERDICT] = np.where(rho < self._clear, ACTUATOR_LOSS, HEALTHY)
        return status
