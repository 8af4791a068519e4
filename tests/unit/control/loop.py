"""A small closed loop for tests: Pinocchio plant, drives, noise; no part of the product.

Plant: aba with 4 substeps of a 1 kHz period, torque lag 1 ms, one cycle of delay, 19-bit
encoders, velocity noise 2 mrad/s, torque steps of a thousandth of a third of the limit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from dftc_rt.control.interface import Law
from dftc_rt.control.laws import build
from dftc_rt.control.signals import AD, AGE, NAMES, QD, TAU_CMD, VD, Q, V

H = 1e-3
ARMATURE = 0.05
ROBOTS = {
    "panda": (
        "panda_description/urdf/panda.urdf",
        ("panda_finger_joint1", "panda_finger_joint2"),
        (0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.7),
    ),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", (), (0.0, -1.2, 1.4, -1.0, -1.5, 0.3)),
}
Rho = Callable[[float], float]


@dataclass
class Robot:
    """Model with armature, limits and home."""

    model: Any
    home: np.ndarray
    limit: np.ndarray
    resolution: np.ndarray

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)

    def loaded(self, kg: float) -> Any:
        """Model with a load 0.1 m beyond the last joint."""
        model = self.model.copy()
        model.inertias[self.n] += pin.Inertia(kg, np.array([0.0, 0.0, 0.1]), np.zeros((3, 3)))
        return model

    def loaded_dynamics(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Whole robot's torque with one more kilogram."""
        return np.array(pin.rnea(self.unit, self.unit_data, q, v, a))

    def inverse_dynamics(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Whole robot's torque."""
        return np.array(pin.rnea(self.model, self.data, q, v, a))

    def __post_init__(self) -> None:
        self.data = self.model.createData()
        self.unit = self.loaded(1.0)
        self.unit_data = self.unit.createData()


@cache
def load(name: str) -> Robot:
    """Robot by name, from example-robot-data."""
    path, locked, home = ROBOTS[name]
    root = Path(str(find_spec("pinocchio").origin)).parents[4]  # type: ignore[union-attr]
    found = sorted(root.rglob(f"example-robot-data/robots/{path}"))
    full = pin.buildModelFromUrdf(str(found[0]))
    ids = [full.getJointId(joint) for joint in locked]
    model = pin.buildReducedModel(full, ids, pin.neutral(full)) if ids else full
    model.armature = np.full(model.nv, ARMATURE)
    limit = np.array(model.effortLimit)
    return Robot(model, np.array(home), limit, limit / 3.0 / 1000.0)


class Terms:
    """M_i and bias_i with the other joints at a surrogate state, straight from rnea."""

    def __init__(self, robot: Robot, interconnection: str) -> None:
        """Remember the surrogate."""
        self.robot = robot
        self.kind = interconnection
        self.inertia = np.zeros(robot.n)
        self.bias = np.zeros(robot.n)

    def update(
        self, q: np.ndarray, v: np.ndarray, qd: np.ndarray, vd: np.ndarray, ad: np.ndarray
    ) -> None:
        """Fill inertia and bias; ``measured`` uses all measurements (and q̈_d for q̈)."""
        robot, zero = self.robot, np.zeros(self.robot.n)
        for i in range(robot.n):
            others = {
                "frozen": (robot.home, zero, zero),
                "desired": (qd, vd, ad),
                "measured": (q, v, ad),
            }[self.kind]
            qs, vs, acc = (np.array(x) for x in others)
            qs[i], vs[i], acc[i] = q[i], v[i], 0.0
            self.bias[i] = pin.rnea(robot.model, robot.data, qs, vs, acc)[i]
            self.inertia[i] = pin.crba(robot.model, robot.data, qs)[i, i]


class Multisine:
    """Sum of five sines per joint, blended in over 1 s from home."""

    def __init__(self, home: np.ndarray, seed: int, amplitude: float = 0.35) -> None:
        """Draw frequencies in 0.1 to 0.5 Hz and phases."""
        rng = np.random.default_rng(seed)
        n = home.shape[0]
        self.home = home
        self.omega = 2.0 * np.pi * rng.uniform(0.1, 0.5, (5, n))
        self.phase = rng.uniform(0.0, 2.0 * np.pi, (5, n))
        self.amplitude = np.full((5, n), amplitude / 5.0**0.5)

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity, acceleration."""
        arg = self.omega * t + self.phase
        a, w = self.amplitude, self.omega
        x = (a * np.sin(arg)).sum(0)
        v = (a * w * np.cos(arg)).sum(0)
        acc = -(a * w * w * np.sin(arg)).sum(0)
        z = min(t, 1.0)
        b = 10 * z**3 - 15 * z**4 + 6 * z**5
        db = 30 * z**2 - 60 * z**3 + 30 * z**4 if t < 1.0 else 0.0
        ddb = 60 * z - 180 * z**2 + 120 * z**3 if t < 1.0 else 0.0
        return self.home + b * x, db * x + b * v, ddb * x + 2 * db * v + b * acc


def make(robot: Robot, name: str = "dftc", *, ftc: bool = True, **gains: Any) -> Law:
    """A law for this robot."""
    model = robot.model
    return build(
        name, robot.n, H, robot.limit, robot.resolution, 1, gains, ftc,
        np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit),
        np.array(model.velocityLimit), robot.inverse_dynamics,
        loaded_dynamics=robot.loaded_dynamics,
    )  # fmt: skip


def run(
    robot: Robot,
    law: Law,
    duration: float,
    *,
    rho: dict[int, Rho] | None = None,
    interconnection: str = "desired",
    seed: int = 0,
    reference: int = 7,
    step_kg: tuple[float, float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Run the loop; ``step_kg`` is when a load comes to the last link, s, and how much, kg.

    Returns:
        Records (cycles, 15, n), and true positions (cycles, n).
    """
    n, model = robot.n, robot.model
    data = model.createData()
    rng = np.random.default_rng(seed)
    terms = Terms(robot, interconnection)
    track = Multisine(robot.home, reference)
    q, v = robot.home.copy(), np.zeros(n)
    applied = np.zeros(n)
    pipeline = np.zeros((2, n))
    cycles = round(duration / H)
    records = np.zeros((cycles, len(NAMES), n))
    truth = np.zeros((cycles, n))
    unit, unit_data = robot.loaded(1.0), robot.loaded(1.0).createData()
    step = 2.0 * np.pi / 2**19
    sub, decay = H / 4, np.exp(-H / 4 / 1e-3)
    applied[:] = pin.rnea(model, data, q, v, v)
    pipeline[:] = applied
    law.start(np.round(q / step) * step, v)
    for k in range(cycles):
        t = k * H
        rec = records[k]
        truth[k] = q
        rec[Q] = np.round(q / step) * step
        rec[V] = v + rng.normal(0.0, 0.002, n)
        rec[QD], rec[VD], rec[AD] = track.at(t)
        rec[AGE] = 0.0
        if law.uses_local_terms:
            terms.update(rec[Q], rec[V], rec[QD], rec[VD], rec[AD])
        motion = rec[QD], rec[VD], rec[AD]
        load = pin.rnea(unit, unit_data, *motion) - pin.rnea(robot.model, robot.data, *motion)
        law.update(rec, terms.inertia, terms.bias, load)
        if step_kg is not None and k == round(step_kg[0] / H):
            model = robot.loaded(step_kg[1])
            data = model.createData()
        for j in range(4):
            applied = pipeline[0] + (applied - pipeline[0]) * decay
            tau = applied.copy()
            for i, effectiveness in (rho or {}).items():
                tau[i] *= effectiveness(t + j * sub)
            v = v + sub * pin.aba(model, data, q, v, tau)
            q = q + sub * v
        pipeline[0] = rec[TAU_CMD]
    return records, truth
