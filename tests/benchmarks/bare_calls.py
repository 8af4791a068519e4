"""The floor of dynamics: bare calls of Pinocchio from Python, nothing around them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from dftc_rt.dynamics.robot import Robot


def aba(robot: Robot, substeps: int) -> Callable[[int], None]:
    """Return a function that makes ``substeps`` calls of ``pin.aba`` a cycle.

    Args:
        robot: The robot, at home.
        substeps: Calls of one cycle.
    """
    model, data = robot.model, robot.model.createData()
    x, v, tau = robot.configuration(robot.home), np.zeros(robot.n), np.zeros(robot.n)

    def run(cycles: int) -> None:
        call = pin.aba
        for _ in range(cycles * substeps):
            call(model, data, x, v, tau)

    return run


def rnea(robot: Robot) -> Callable[[int], None]:
    """Return a function that makes one call of ``pin.rnea`` a cycle.

    Args:
        robot: The robot, at home.
    """
    model, data = robot.model, robot.model.createData()
    x, v, a = robot.configuration(robot.home), np.zeros(robot.n), np.zeros(robot.n)

    def run(cycles: int) -> None:
        call = pin.rnea
        for _ in range(cycles):
            call(model, data, x, v, a)

    return run
