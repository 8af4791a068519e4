"""What the tests of the baselines share: matrices from Pinocchio, laws, a single joint."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from dftc_rt.control.interface import Law
from dftc_rt.control.laws import build
from dftc_rt.control.signals import NAMES
from tests.unit.control.loop import H, Robot

AddFriction = Callable[[np.ndarray, np.ndarray], None]


class Matrices:
    """M and G from Pinocchio; C by differences of M, so not from the library's own routine."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        return np.array(pin.crba(self.robot.model, self.robot.data, q))

    def coriolis_matrix(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        n, step = len(q), 1e-6
        slope = np.empty((n, n, n))  # dM_ij/dq_k
        for k, unit in enumerate(np.eye(n)):
            ahead, behind = self.mass_matrix(q + step * unit), self.mass_matrix(q - step * unit)
            slope[:, :, k] = (ahead - behind) / (2.0 * step)
        symbols = 0.5 * (slope + slope.transpose(0, 2, 1) - slope.transpose(2, 1, 0))
        return np.asarray(symbols @ v)

    def gravity(self, q: np.ndarray) -> np.ndarray:
        return np.array(pin.computeGeneralizedGravity(self.robot.model, self.robot.data, q))


class QuickMatrices(Matrices):
    """The same with Pinocchio's C, for closed loops."""

    def coriolis_matrix(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.array(pin.computeCoriolisMatrix(self.robot.model, self.robot.data, q, v))


def make(
    robot: Robot,
    name: str,
    *,
    ftc: bool = True,
    matrices: Matrices | None = None,
    add_friction: AddFriction | None = None,
    effectiveness: Callable[[float, np.ndarray], None] | None = None,
    resolution: float | None = None,
    delay: int = 1,
    **gains: Any,
) -> Law:
    """A law for this robot; ``resolution`` 0 takes the drive's steps away."""
    model = robot.model
    steps = robot.resolution if resolution is None else np.full(robot.n, resolution)
    return build(
        name, robot.n, H, robot.limit, steps, delay, gains, ftc,
        np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit),
        np.array(model.velocityLimit), robot.inverse_dynamics, add_friction,
        matrices or QuickMatrices(robot), effectiveness,
    )  # fmt: skip


def make_single(name: str, *, ftc: bool = True, limit: float = 50.0, **gains: Any) -> Law:
    """A law for one joint on which the tests' own plant is built; no delay in the drive."""
    return build(
        name, 1, H, np.array([limit]), np.zeros(1), 0, {"torque_lag_s": 0.0} | gains, ftc,
        np.array([-3.0]), np.array([3.0]), np.array([3.0]),
    )  # fmt: skip


def random_record(robot: Robot, seed: int) -> np.ndarray:
    """A record (15, n) with a measured and a desired state near home."""
    rec = np.zeros((len(NAMES), robot.n))
    rec[:5] = np.random.default_rng(seed).normal(0.0, 0.1, (5, robot.n))
    rec[0] += robot.home
    rec[2] += robot.home
    return rec


def friction(torque: np.ndarray, v: np.ndarray) -> None:
    """Some friction: 2 v + 0.5 tanh(v / 0.01)."""
    torque += 2.0 * v + 0.5 * np.tanh(v / 0.01)
