"""The true robot: forward dynamics, friction, torque lag, actuator faults and brakes.

    M(q) a + C(q, v) v + G(q) = rho u_m - viscous v - coulomb tanh(v / V_STICK)

u_m, the motors' torque, follows the command through a first-order lag; rho is the
effectiveness, which only this side knows. Semi-implicit Euler at a fixed step. A joint
whose brake is closed is held exactly: the rest moves under the constraint. Where the
acceleration comes from is :mod:`hil.plants.dynamics`.

Source: [zhao2017] eq. (2), (36).
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import DriveTable, PlantTable
from dftc_rt.dynamics.model import Robot
from hil.faults import effectiveness
from hil.plants.dynamics import forward_dynamics
from hil.plants.per_joint import per_joint

F64 = NDArray[np.float64]

V_STICK: Final = 0.01  # rad/s at which Coulomb friction has all but reached its value


@numba.njit(cache=True, error_model="numpy")
def _torques(
    t: float,
    alpha: float,
    faults: NDArray[np.void],
    rows: F64,
    v: F64,
    friction: F64,
    tau: F64,
) -> None:
    """Motor lag, effectiveness and friction: the torque that moves the links.

    ``rows`` is (5, n): command, motor torque, applied torque, rho, fault.
    """
    effectiveness(t, faults, rows[3], rows[4])
    for i in range(v.shape[0]):
        rows[1, i] += alpha * (rows[0, i] - rows[1, i])
        rows[2, i] = rows[3, i] * rows[1, i]
        tau[i] = rows[2, i] - friction[0, i] * v[i] - friction[1, i] * np.tanh(v[i] / V_STICK)


@numba.njit(cache=True)
def _integrate(dt: float, a: F64, v: F64, q: F64) -> None:
    for i in range(v.shape[0]):
        v[i] += dt * a[i]
        q[i] += dt * v[i]


@numba.njit(cache=True, error_model="numpy")
def _step(
    t: float,
    dt: float,
    a: F64,
    q: F64,
    v: F64,
    alpha: float,
    faults: NDArray[np.void],
    rows: F64,
    friction: F64,
    tau: F64,
) -> None:
    """Integrate one substep, then find the torque of the next, which begins at ``t``."""
    _integrate(dt, a, v, q)
    _torques(t, alpha, faults, rows, v, friction, tau)


class RigidBodyPlant:
    """A robot that moves.

    Attributes:
        n: Number of joints.
        t: Rig time, s; a whole number of substeps.
        q: True position, (n,), rad.
        v: True velocity, (n,), rad/s.
        command: Torque the motors are told, (n,), Nm.
        motor: Torque the motors would give when healthy, (n,), Nm: current times
            nominal torque constant, so it does not know the loss.
        applied: Torque the motors do give, rho times ``motor``, (n,), Nm.
        rho: Effectiveness, (n,).
        fault: 1.0 while a fault of the joint is active, (n,).
        released: Whether each brake is open, (n,), bool; set through :meth:`set_brakes`.
    """

    def __init__(
        self,
        robot: Robot,
        plant: PlantTable,
        drive: DriveTable,
        faults: NDArray[np.void],
        period_s: float,
        q0: F64,
        v0: F64,
    ) -> None:
        """Build the true robot at rest or in motion at ``q0``, ``v0``, brakes closed.

        Args:
            robot: What the controller believes.
            plant: What is true: payload, friction, armature, substeps.
            drive: Torque lag.
            faults: From :func:`hil.faults.compile_faults`.
            period_s: Control period, s.
            q0: Initial position, (n,), rad.
            v0: Initial velocity, (n,), rad/s, kept until the brakes open.

        Raises:
            InputError: A per-joint value has the wrong length, or the robot has a closed form
                that has no place for it.
        """
        n = self.n = robot.n
        self._dynamics = forward_dynamics(robot, plant)
        self.dt = period_s / plant.substeps
        self._alpha = 1.0 - np.exp(-self.dt / drive.torque_lag_s) if drive.torque_lag_s > 0 else 1.0
        self._faults = faults
        self._friction = np.stack(
            [
                per_joint(plant.viscous, n, "rig.plant.viscous"),
                per_joint(plant.coulomb, n, "rig.plant.coulomb"),
            ]
        )
        self.rows = np.zeros((5, n))
        self.command, self.motor, self.applied, self.rho, self.fault = self.rows
        self.rho[:] = 1.0
        self._tau = np.zeros(n)
        self._at_rest = np.zeros(n)
        self.q, self.v = q0.astype(np.float64).copy(), np.zeros(n)
        self._v0 = v0.astype(np.float64).copy()
        self.released = np.zeros(n, dtype=bool)
        self._all_released = False
        self._any_released = False
        self._steps = 0
        effectiveness(0.0, faults, self.rho, self.fault)

    @property
    def t(self) -> float:
        """Rig time, s."""
        return self._steps * self.dt

    def set_brakes(self, released: NDArray[np.bool_]) -> None:
        """Open and close brakes; a brake that closes takes the joint's velocity at once."""
        if np.array_equal(released, self.released):
            return
        opened = released & ~self.released
        closed = ~released & self.released
        self.v[opened] = self._v0[opened]
        self._v0[opened] = 0.0
        if closed.any():
            # Inelastic: M (v+ - v) = J^T impulse with v+ = 0 on every closed brake.
            held = ~released
            M = self._dynamics.mass_matrix(self.q)
            free = released
            v_held = self.v[held].copy()
            self.v[held] = 0.0
            if free.any():
                self.v[free] += np.linalg.solve(
                    M[np.ix_(free, free)], M[np.ix_(free, held)] @ v_held
                )
        self.released[:] = released
        self._all_released = bool(released.all())
        self._any_released = bool(released.any())
        self.motor[~released] = 0.0

    def advance(self, steps: int) -> None:
        """Integrate ``steps`` substeps of ``dt``."""
        if steps <= 0:
            return
        rows, q, v, tau, dt = self.rows, self.q, self.v, self._tau, self.dt
        alpha, faults, friction = self._alpha, self._faults, self._friction
        _torques(self._steps * dt, alpha, faults, rows, v, friction, tau)
        for left in range(steps - 1, -1, -1):
            a = self._acceleration()
            self._steps += 1
            if left:
                _step(self._steps * dt, dt, a, q, v, alpha, faults, rows, friction, tau)
            else:
                _integrate(dt, a, v, q)

    def _acceleration(self) -> F64:
        """Forward dynamics under the brakes, (n,), rad/s^2."""
        if self._all_released:
            return self._dynamics.acceleration(self.q, self.v, self._tau)
        if self._any_released:
            return self._constrained()
        return self._at_rest

    def _constrained(self) -> F64:
        """Acceleration, (n,), with the closed brakes' joints at rest."""
        h = self._dynamics.bias(self.q, self.v)
        M = self._dynamics.mass_matrix(self.q)
        free = self.released
        a = np.zeros(self.n)
        a[free] = np.linalg.solve(M[np.ix_(free, free)], (self._tau - h)[free])
        self.motor[~free] = 0.0
        self.applied[~free] = 0.0
        return a
