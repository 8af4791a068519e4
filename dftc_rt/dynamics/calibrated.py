"""A robot as a calibration says it is."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from dftc_rt.config.calibration import Calibration, check_joints
from dftc_rt.dynamics.friction import Friction
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.payload import with_armature
from dftc_rt.dynamics.regressor import last_joints, pseudo_inertia, with_inertial_parameters
from dftc_rt.errors import InputError

Array = npt.NDArray[np.float64]


def calibrated(robot: Robot, calibration: Calibration, where: str) -> Robot:
    """Return the robot with the calibration's load, armature, friction and torque constants.

    Args:
        robot: The nominal robot; it is not changed.
        calibration: What fault-free motion told.
        where: Its file, for messages.

    Raises:
        InputError: It is another robot's, or a link that no body can have.
    """
    check_joints(calibration, robot.name, robot.joints, where)
    _refuse_more_than_the_drive(robot, calibration, where)

    def column(name: str) -> Array:
        return np.array([getattr(joint, name) for joint in calibration.joint])

    model = robot.model
    if robot.closed_form is None:
        model = with_armature(_with_links(robot, calibration, where), column("armature"))
    elif calibration.link:
        expected = f"none: '{robot.closed_form.name}' has a closed form"
        raise InputError(f"{where}: link", f"found {len(calibration.link)} links", expected)
    return dataclasses.replace(
        robot,
        model=model,
        friction=Friction(column("viscous"), column("coulomb"), column("offset")),
        torque_constant=tuple(joint.torque_constant for joint in calibration.joint),
    )


def _refuse_more_than_the_drive(robot: Robot, calibration: Calibration, where: str) -> None:
    """Refuse friction that the drive could not overcome: a wrong file moves the arm."""
    for index, (joint, limit) in enumerate(zip(calibration.joint, robot.torque_limit, strict=True)):
        for name in ("viscous", "coulomb", "offset"):
            value = abs(getattr(joint, name))
            if value > limit:
                found, expected = f"{value:g}", f"at most the torque limit, {limit:g}"
                raise InputError(f"{where}: joint[{index}].{name}", found, expected)


def _with_links(robot: Robot, calibration: Calibration, where: str) -> Robot:
    """The robot with other last links."""
    expected = tuple(robot.joints[i] for i in last_joints(robot))
    found = tuple(link.joint for link in calibration.link)
    if found != expected:
        raise InputError(f"{where}: link", "found " + ", ".join(found), ", ".join(expected))
    links = np.array(
        [[link.mass_kg, *link.first_moment_kg_m, *link.inertia_kg_m2] for link in calibration.link]
    )
    for index, link in enumerate(links):
        if not np.linalg.eigvalsh(pseudo_inertia(link))[0] > 0.0:
            what = "mass, first moment and inertia that no body has"
            raise InputError(f"{where}: link[{index}]", what, "a positive definite pseudo-inertia")
    return dataclasses.replace(robot, model=with_inertial_parameters(robot, links))
