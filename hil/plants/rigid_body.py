"""The true robot: forward dynamics, friction, motors, faults and brakes.

    M(q) a + C(q, v) v + G(q) = u - F(v) + J^T f

u is what the motors give (:mod:`hil.plants.motors`), F friction (:mod:`hil.plants.friction`),
f a force from outside (:mod:`hil.plants.outside`); where M, C and G come from is
:mod:`hil.plants.dynamics`. Semi-implicit Euler at a fixed step. A joint whose brake is closed
is held exactly: the rest moves under the constraint.

Source: [zhao2017] eq. (2), (36).
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import DriveTable, PlantTable
from dftc_rt.dynamics.model import Robot
from hil.faults import LOCK
from hil.plants import layout
from hil.plants.dynamics import forward_dynamics
from hil.plants.friction import bend, joint_parameters, resist
from hil.plants.motors import drive as drive_motors
from hil.plants.motors import reveal
from hil.plants.outside import Outside, check_outside
from hil.plants.urdf import UrdfDynamics

F64 = NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def _torques(
    t: float,
    dt: float,
    alpha: float,
    faults: NDArray[np.void],
    rows: F64,
    v: F64,
    joints: F64,
    tau: F64,
) -> None:
    """Motors, faults and friction: the torque that moves the links."""
    drive_motors(t, dt, alpha, faults, joints, rows)
    resist(dt, v, joints, rows, tau)


@numba.njit(cache=True)
def _integrate(dt: float, a: F64, v: F64, q: F64, rows: F64) -> None:
    for i in range(v.shape[0]):
        v[i] += dt * a[i]
        q[i] += dt * v[i]
    bend(v, rows)


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
    joints: F64,
    tau: F64,
) -> None:
    """Integrate one substep, then find the torque of the next, which begins at ``t``."""
    _integrate(dt, a, v, q, rows)
    _torques(t, dt, alpha, faults, rows, v, joints, tau)


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
        applied: Torque the motors do give, (n,), Nm.
        rho: Effectiveness, (n,).
        fault: 1.0 while a fault of the joint, or of the arm as a whole, is active, (n,).
        rows: State as the kernels have it, (N_STATE, n): :mod:`hil.plants.layout`.
        released: Whether each brake is open, (n,), bool; set through :meth:`set_brakes`.
        locked: Whether a fault blocks the joint, (n,), bool.
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
            plant: What is true: payload, friction, torque constants, armature, substeps.
            drive: Torque lag.
            faults: From :func:`hil.faults.compile_faults`.
            period_s: Control period, s.
            q0: Initial position, (n,), rad.
            v0: Initial velocity, (n,), rad/s, kept until the brakes open.

        Raises:
            InputError: A per-joint value has the wrong length, friction contradicts itself, or
                the robot has a closed form that has no place for something.
        """
        n = self.n = robot.n
        self._dynamics = forward_dynamics(robot, plant)
        self._outside = None
        if check_outside(robot, faults) and isinstance(self._dynamics, UrdfDynamics):
            self._outside = Outside(self._dynamics, faults)
        self.dt = period_s / plant.substeps
        self._alpha = 1.0 - np.exp(-self.dt / drive.torque_lag_s) if drive.torque_lag_s > 0 else 1.0
        self._robot = robot
        self._faults = faults
        self._joints = joint_parameters(robot, plant)
        self.rows = np.zeros((layout.N_STATE, n))
        self.command, self.motor, self.applied, self.rho, self.fault = self.rows[:5]
        self.rows[layout.FRICTION] = 1.0
        self.rows[layout.DECAY] = 1.0
        bristles = bool(self._joints[layout.STIFFNESS].any())
        self._added = self.rows[layout.ADDED] if bristles else None
        self._tau = np.zeros(n)
        self._at_rest = np.zeros(n)
        self.q, self.v = q0.astype(np.float64).copy(), np.zeros(n)
        self._v0 = v0.astype(np.float64).copy()
        self.released = np.zeros(n, dtype=bool)
        self.locked = np.zeros(n, dtype=bool)
        self._locks = faults[faults["profile"] == LOCK]
        self._free = np.zeros(n, dtype=bool)  # neither braked nor locked
        self._all_free = False
        self._any_free = False
        self._steps = 0
        self.reveal()

    @property
    def t(self) -> float:
        """Rig time, s."""
        return self._steps * self.dt

    def change_faults(self, faults: NDArray[np.void]) -> None:
        """Take other faults from now on.

        Args:
            faults: From :func:`hil.faults.compile_faults`.

        Raises:
            InputError: The robot has a closed form that has no place for one; nothing changes.
        """
        outside = check_outside(self._robot, faults)
        if isinstance(self._dynamics, UrdfDynamics) and (outside or self._outside is not None):
            self._outside = Outside(self._dynamics, faults)  # takes off what is carried no more
        self._faults = faults
        self._locks = faults[faults["profile"] == LOCK]
        self._lock()

    def reveal(self) -> None:
        """Bring ``rho`` and ``fault`` up to rig time."""
        reveal(self._steps * self.dt, self._faults, self._joints, self.rows)

    def set_brakes(self, released: NDArray[np.bool_]) -> None:
        """Open and close brakes; a brake that closes takes the joint's velocity at once."""
        if np.array_equal(released, self.released):
            return
        opened = released & ~self.released & ~self.locked
        self.v[opened] = self._v0[opened]
        self._v0[opened] = 0.0
        self.released[:] = released
        self._hold()
        self.rows[layout.MOTOR, ~released] = 0.0
        self.rows[layout.LAGGED, ~released] = 0.0

    def _lock(self) -> None:
        """Block and free the joints that faults lock at this time, at once as a brake does."""
        t = self.t
        active = self._locks[(self._locks["start"] <= t) & (t < self._locks["end"])]
        locked = np.zeros(self.n, dtype=bool)
        locked[active["joint"]] = True
        if not np.array_equal(locked, self.locked):
            self.locked[:] = locked
            self._hold()

    def _hold(self) -> None:
        """Take the velocity of the joints that are no longer free."""
        free = self.released & ~self.locked
        if (self._free & ~free).any():
            # Inelastic: M (v+ - v) = J^T impulse with v+ = 0 on every joint that is held.
            held = ~free
            M = self._dynamics.mass_matrix(self.q)
            v_held = self.v[held].copy()
            self.v[held] = 0.0
            if free.any():
                self.v[free] += np.linalg.solve(
                    M[np.ix_(free, free)], M[np.ix_(free, held)] @ v_held
                )
        self._free[:] = free
        self._all_free = bool(free.all())
        self._any_free = bool(free.any())

    def advance(self, steps: int) -> None:
        """Integrate ``steps`` substeps of ``dt``."""
        if steps <= 0:
            return
        rows, q, v, tau, dt = self.rows, self.q, self.v, self._tau, self.dt
        alpha, faults, joints = self._alpha, self._faults, self._joints
        if self._locks.size:
            self._lock()
        _torques(self._steps * dt, dt, alpha, faults, rows, v, joints, tau)
        for left in range(steps - 1, -1, -1):
            a = self._acceleration()
            self._steps += 1
            if left:
                _step(self._steps * dt, dt, a, q, v, alpha, faults, rows, joints, tau)
            else:
                _integrate(dt, a, v, q, rows)

    def _acceleration(self) -> F64:
        """Forward dynamics under the brakes, (n,), rad/s^2."""
        if self._outside is not None:
            self._outside.push(self._steps * self.dt, self.q, self._tau)
        if self._all_free:
            return self._dynamics.acceleration(self.q, self.v, self._tau, self._added)
        if self._any_free:
            return self._constrained()
        self.applied[:] = 0.0  # nothing of it reaches a link
        return self._at_rest

    def _constrained(self) -> F64:
        """Acceleration, (n,), with the joints at rest that brakes or faults hold."""
        h = self._dynamics.bias(self.q, self.v)
        M = self._dynamics.mass_matrix(self.q)
        if self._added is not None:
            M = M + np.diag(self._added)
        free = self._free
        a = np.zeros(self.n)
        a[free] = np.linalg.solve(M[np.ix_(free, free)], (self._tau - h)[free])
        self.motor[~self.released] = 0.0  # off; a motor that is blocked pushes on
        self.applied[~free] = 0.0
        return a
