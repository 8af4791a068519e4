"""Which implementation a robot's dynamics have: its URDF's, or a closed form."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dftc_rt.dynamics.closed_form.local_terms import ClosedFormTerms
from dftc_rt.dynamics.closed_form.whole_body import ClosedFormBody
from dftc_rt.dynamics.friction import TermsWithFriction
from dftc_rt.dynamics.interface import EquationsOfMotion, JointTerms, LagrangianTerms
from dftc_rt.dynamics.local_terms import LocalTerms
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.surrogate import Interconnection
from dftc_rt.dynamics.whole_body import WholeBody

Array = npt.NDArray[np.float64]


def local_terms(
    robot: Robot, interconnection: Interconnection, frozen_q: Array | None = None
) -> JointTerms:
    """Local terms of a robot, as the loop evaluates them.

    Args:
        robot: The robot.
        interconnection: ``frozen``, ``desired`` or ``measured``.
        frozen_q: (n,) reference configuration of ``frozen``, rad; None: home.

    Raises:
        InputError: No such ``interconnection``.
    """
    terms: JointTerms
    if robot.closed_form is None:
        terms = LocalTerms(robot, interconnection, frozen_q)
    else:
        frozen = robot.home if frozen_q is None else frozen_q
        terms = ClosedFormTerms(robot.closed_form, interconnection, frozen)
    return terms if robot.friction is None else TermsWithFriction(terms, robot.friction)


def whole_body(robot: Robot) -> EquationsOfMotion:
    """Equations of motion of the whole robot."""
    if robot.closed_form is None:
        return WholeBody(robot)
    return ClosedFormBody(robot.closed_form)


def lagrangian_terms(robot: Robot) -> LagrangianTerms | None:
    """M, C and G of the whole robot; None for a closed form, which states C q̇ + G as one."""
    return WholeBody(robot) if robot.closed_form is None else None
