"""Inverse dynamics, linear in the inertial parameters of the links at the end of a chain.

Source: pinocchio.computeJointTorqueRegressor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.select import whole_body

Array = npt.NDArray[np.float64]

PARAMETERS = 10
"""Inertial parameters of a link: mass, mass times centre of mass (3), inertia about the origin of
its joint's frame (xx, xy, yy, xz, yz, zz), in kg, kg m, kg m²."""


def last_joints(robot: Robot) -> tuple[int, ...]:
    """Joints without a child, by index: the links that may carry an unknown load.

    A closed form has none: its inertia is written down.
    """
    if robot.closed_form is not None:
        return ()
    parents = {int(robot.model.parents[i + 1]) - 1 for i in range(robot.n)}
    return tuple(i for i in range(robot.n) if i not in parents)


def rows(robot: Robot, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Torque of the nominal model, and how it changes with the load.

    Args:
        robot: The robot.
        q: (K, n), rad.
        v: (K, n), rad/s.
        a: (K, n), rad/s².

    Returns:
        Torque (K, n), Nm, and regressor (K, n, 10 L) of the L last links' parameters.
    """
    if robot.closed_form is not None:
        body = whole_body(robot)
        exact = [body.inverse_dynamics(*each) for each in zip(q, v, a, strict=True)]
        return np.array(exact), np.zeros((*q.shape, 0))
    model, data = robot.model, robot.model.createData()
    last = last_joints(robot)
    columns = np.concatenate([np.arange(PARAMETERS) + PARAMETERS * i for i in last])
    torque = np.empty_like(q)
    regressor = np.empty((*q.shape, columns.size))
    for k in range(len(q)):
        x = robot.configuration(q[k])
        torque[k] = pin.rnea(model, data, x, v[k], a[k])
        full = pin.computeJointTorqueRegressor(model, data, x, v[k], a[k])
        regressor[k] = full[:, columns]
    return torque, regressor


def inertial_parameters(robot: Robot) -> Array:
    """Nominal parameters of the last links, (L, 10)."""
    inertias = robot.model.inertias
    found = [inertias[i + 1].toDynamicParameters() for i in last_joints(robot)]
    return np.array(found).reshape(-1, PARAMETERS)


def pseudo_inertia(parameters: Array) -> Array:
    """Pseudo-inertia matrix (4, 4) of one link's 10 parameters; physical if positive definite."""
    matrix: Array = pin.PseudoInertia.FromDynamicParameters(parameters).toMatrix()
    return matrix


def with_inertial_parameters(robot: Robot, parameters: Array) -> Any:
    """Copy of the model with other last links.

    Args:
        robot: The robot.
        parameters: (L, 10), each with a positive definite pseudo-inertia.
    """
    model = robot.model.copy()
    for i, values in zip(last_joints(robot), parameters, strict=True):
        model.inertias[i + 1] = pin.Inertia.FromDynamicParameters(values)
    return model
