"""Models that differ from what the controller believes: a payload, another armature."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from dftc_rt.dynamics.model import Robot
from dftc_rt.errors import InputError

Array = npt.NDArray[np.float64]

LOAD_COM_M: Final = (0.0, 0.0, 0.1)
"""Where a load is assumed, in the frame of the last link, m: beyond the flange."""


def with_payload(
    robot: Robot, mass_kg: float, com_m: Sequence[float], joint: str | None = None
) -> Any:
    """Model of the robot with a point mass fixed to a link.

    Args:
        robot: The robot; it is not changed.
        mass_kg: 0 or more.
        com_m: (3,) place of the mass in the frame of the link behind ``joint``, m.
        joint: The joint whose link carries it; None: the last of the model.

    Returns:
        A new ``pin.Model``.

    Raises:
        InputError: Negative or infinite mass, a place that is no point, or no such joint.
    """
    if not 0.0 <= mass_kg < np.inf:
        raise InputError("payload_kg", f"found {mass_kg}", "0 or more, finite")
    com = np.asarray(com_m, dtype=np.float64)
    if com.shape != (3,) or not np.isfinite(com).all():
        raise InputError("payload_com_m", f"found {list(com_m)}", "3 finite numbers")
    index = robot.n if joint is None else robot.joint_index(joint) + 1
    model = robot.model.copy()
    model.inertias[index] += pin.Inertia(float(mass_kg), com, np.zeros((3, 3)))
    return model


def with_unit_load(robot: Robot) -> Robot:
    """The robot with one more kilogram at the last link, where :class:`UnitLoad` has it."""
    return dataclasses.replace(robot, model=with_payload(robot, 1.0, LOAD_COM_M))


def with_armature(model: Any, armature: float | npt.ArrayLike) -> Any:
    """Copy of a model with another armature.

    Args:
        model: ``pin.Model``, or a :class:`Robot`.
        armature: Scalar or (n,), kg m^2 (kg for a prismatic joint).

    Raises:
        InputError: Not one number or n of them, or a negative one.
    """
    copy = (model.model if isinstance(model, Robot) else model).copy()
    values = np.asarray(armature, dtype=np.float64)
    if values.shape not in ((), (copy.nv,)) or not ((values >= 0.0) & (values < np.inf)).all():
        expected = f"a number or {copy.nv} of them, 0 or more"
        raise InputError("armature", f"found {values.tolist()}", expected)
    copy.armature = np.broadcast_to(values, (copy.nv,)).copy()
    return copy


class UnitLoad:
    """Torque of one kilogram at the last link, along the desired motion.

    Stored before the run or computed from it alone, so any joint may know its own entry.
    """

    def __init__(self, robot: Robot, com_m: Sequence[float] = LOAD_COM_M) -> None:
        """Prepare two models, without and with the kilogram."""
        self._robot = robot
        self._x = np.zeros(robot.model.nq)
        self._models = [
            (model, model.createData()) for model in (robot.model, with_payload(robot, 1.0, com_m))
        ]

    def torque(self, qd: Array, vd: Array, ad: Array, out: Array) -> None:
        """Write the torque of the kilogram, (n,), Nm/kg.

        Args:
            qd: (n,) desired, rad.
            vd: (n,) desired, rad/s.
            ad: (n,) desired, rad/s^2.
            out: (n,), written.
        """
        x = self._robot.configuration(qd, self._x)
        (bare, data), (loaded, loaded_data) = self._models
        pin.rnea(loaded, loaded_data, x, vd, ad)
        pin.rnea(bare, data, x, vd, ad)
        np.subtract(loaded_data.tau, data.tau, out=out)
