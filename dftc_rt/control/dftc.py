"""The laws ``dftc`` and ``paper``: one composition of the blocks, two sets of settings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dftc_rt.control import derate, kernel, layout, probe, settings
from dftc_rt.control.interface import F64, WANTS_RESPONSE, InverseDynamics
from dftc_rt.control.layout import Joints
from dftc_rt.control.settings import Value
from dftc_rt.control.signals import QD, VD
from dftc_rt.errors import InputError

_MODEL_RBF = 1
_MOST_KG = 5.0  # of the load that a test is compared with
_MOST_TICKS = 100_000  # bounds the time a skip takes; filters have settled long before


class Dftc:
    """Decentralised fault-tolerant law (10) with identifier, observer, decision and gain (33).

    Attributes:
        ftc: Whether the gain (33) is applied.
        uses_local_terms: False when the models are RBF networks alone.
        joints: What was given of the robot and its drives.
        storage: Parameters, states and weights.

    Source: [zhao2017]; the robust elements are ours.
    """

    def __init__(
        self,
        joints: Joints,
        gains: Mapping[str, Value],
        inverse_dynamics: InverseDynamics | None = None,
        loaded_dynamics: InverseDynamics | None = None,
        *,
        ftc: bool,
        printed: bool = False,
    ) -> None:
        """Allocate the law.

        Args:
            joints: Robot and drives.
            gains: Keys of :data:`dftc_rt.control.settings.NAMES`.
            inverse_dynamics: Torque for a motion, whole robot: how the other joints give way to
                a test torque, at the desired pose. None: no tests.
            loaded_dynamics: The same with one more kilogram at the last link; None: unknown.
            ftc: Whether the gain (33) is applied.
            printed: Start from the paper's printed values instead of the defaults.

        Raises:
            InputError: A gain is unknown or out of bounds.
        """
        self.joints = joints
        self.ftc = ftc
        parsed = settings.parse(gains, joints.torque_limit.shape[0], printed=printed)
        if printed:
            parsed.weights.setdefault("w_f", np.arange(2.0, 15.0, 2.0))
            parsed.weights.setdefault("w_g", np.arange(2.0, 15.0, 2.0))
        self.uses_local_terms = bool((parsed.values["model"] != _MODEL_RBF).any())
        self.storage = layout.allocate(parsed, joints, ftc=ftc)
        store = self.storage
        self._arrays = (
            store.parameters, store.state, store.weights, store.centres, store.sigma,
            store.history, store.moments, store.correlations, store.sums,
        )  # fmt: skip
        par = store.parameters
        self._dead_s = (par["delay"] + 0.5) * par["period"] + par["torque_lag_s"]
        self._inverse_dynamics = inverse_dynamics
        self._loaded_dynamics = loaded_dynamics
        self._no_load = np.zeros(joints.torque_limit.shape[0])
        self._cycle = kernel.CYCLE

    def start(self, q: F64, v: F64) -> None:
        """Reset every state, weights to their initial values.

        Args:
            q: Measured positions, (n,), rad.
            v: Measured velocities, (n,), rad/s.

        Raises:
            InputError: A shape is wrong or a value is not finite.
        """
        store = self.storage
        n = store.parameters.shape[0]
        for name, values in (("q", q), ("v", v)):
            if np.shape(values) != (n,) or not np.all(np.isfinite(values)):
                raise InputError(f"start {name}", str(values), f"{n} finite values")
        state, par = store.state, store.parameters
        state[:] = 0
        state["gain"] = 1.0
        state["rho"] = 1.0
        state["rho_var"] = par["rho_std_max"] ** 2
        state["q_last"] = q
        state["v_last"] = v
        state["m_last"] = 1.0
        state["x1o"] = q + par["x1o_offset"]
        state["x2o"] = v + par["x2o_offset"]
        state["x1fo"] = state["x1o"]
        state["x2fo"] = state["x2o"]
        store.weights[:] = store.initial_weights
        store.history[:] = 0.0
        store.moments[:] = 0.0
        state["probe_at"] = probe.IDLE
        self._response(0, np.array(q, dtype=np.float64))  # loads what a test will call

    def skip(self, ticks: int) -> None:
        """Ticks without a cycle, see :class:`dftc_rt.control.interface.Law`."""
        store = self.storage
        kernel.skip(store.parameters, store.state, store.history, min(ticks, _MOST_TICKS))

    def told(self, joint: int, tau: float) -> None:
        """Another command was sent, see :class:`dftc_rt.control.interface.Law`."""
        history = self.storage.history
        last = int(self.storage.state["cycle"][joint]) - 1
        history[joint, last % history.shape[1]] = tau

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """One cycle, see :class:`dftc_rt.control.interface.Law`; real-time safe."""
        status = self._cycle(
            rec, inertia, bias, self._no_load if load is None else load, *self._arrays
        )
        if status & WANTS_RESPONSE:
            self._respond(rec)
            status &= ~WANTS_RESPONSE
        return status

    def _respond(self, rec: F64) -> None:
        """Tell one joint that wants to test how the arm will answer; a rare cycle.

        It takes some 0.2 ms; joints that ask at the same time are answered one a cycle.
        """
        par, state = self.storage.parameters, self.storage.state
        i = int(np.argmax(state["probe_at"] == probe.ASKED))
        half = 0.5 * float(par["probe_length"][i] * par["period"][i])
        probe.answer(state, self.storage.sums, i, *self._response(i, rec[QD] + half * rec[VD]))

    def _response(self, i: int, pose: F64) -> tuple[complex | None, complex | None]:
        """G of joint i at a pose (n,), rad, as it is and with the load that explains e."""
        if self._inverse_dynamics is None:
            return None, None
        par, state = self.storage.parameters, self.storage.state
        mass = derate.mass_matrix(self._inverse_dynamics, pose)
        omega = probe.frequency(i, float(par["probe_length"][i] * par["period"][i]))
        rest = np.diag(mass), i, omega, par["lam"], par["k"], self._dead_s
        if self._loaded_dynamics is None:
            return probe.response(mass, *rest), None
        unit = derate.mass_matrix(self._loaded_dynamics, pose) - mass
        mass = mass + float(state["mass"][i]) * unit
        kg = float(np.clip(state["h_load"][i], 0.0, _MOST_KG))
        return probe.response(mass, *rest), probe.response(mass + kg * unit, *rest)
