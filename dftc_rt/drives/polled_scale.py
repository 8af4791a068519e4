"""What the scales of drives without SYNC have in common, whatever their numbers are.

Such a drive is configured with its maker's tools. The bus tells where it is and not whether its
zero is the robot file's, so that its joint's limits are what it can be checked against.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dftc_rt.config.robot import JointConfig
from dftc_rt.drives.scale import JointScale
from dftc_rt.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class PolledScale(JointScale):
    """One joint's drive: its data sheet, where it can be, and whom it answers.

    Attributes:
        lower: Joint's lower position limit, rad (m); -inf for none.
        upper: Joint's upper position limit, rad (m); inf for none.
        host_id: Identifier of the controller.
    """

    lower: float = -math.inf
    upper: float = math.inf
    host_id: int = 0


def refuse_host_id(where: str, host_id: int, joints: Sequence[JointConfig]) -> None:
    """Refuse a controller with the node id of a drive.

    Args:
        where: Key path of the host id.
        host_id: The controller's.
        joints: The joints.

    Raises:
        InputError: A drive has it.
    """
    for joint in joints:
        if joint.node_id == host_id:
            raise InputError(where, f"{host_id} is the node id of {joint.name}", "another one")
