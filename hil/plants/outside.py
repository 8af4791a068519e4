"""What comes and goes at the arm as a whole: payloads and contacts.

They confound a fault diagnosis: torque is missing, and no motor has lost any.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.dynamics.model import Robot
from dftc_rt.errors import InputError
from hil.faults import CONTACT, PAYLOAD
from hil.plants.urdf import UrdfDynamics

F64 = NDArray[np.float64]

_KINDS: Final = {PAYLOAD: "payload", CONTACT: "contact"}


class Outside:
    """Puts payloads on the true robot and takes them off, and pushes it."""

    def __init__(self, dynamics: UrdfDynamics, faults: NDArray[np.void]) -> None:
        """Take the faults that act on the arm as a whole.

        Args:
            dynamics: The true robot's; its links are loaded and unloaded.
            faults: From :func:`hil.faults.compile_faults`; others are passed over.
        """
        self._dynamics = dynamics
        self._faults = [row for row in faults if row["profile"] in _KINDS]
        self._contacts: list[tuple[int, F64]] = []
        self._next = 0.0

    def push(self, t: float, q: F64, tau: F64) -> None:
        """Add what contacts do at rig time ``t``, s, to the torque ``tau``, (n,), Nm.

        A payload that is due is put on or taken off first. It comes with the velocity of its
        link, so that no joint's velocity jumps.

        Args:
            t: Rig time, s, which does not run backwards.
            q: Position, (n,), rad.
            tau: Torque on the joints; changed.
        """
        if t >= self._next:
            self._change(t)
        for joint, force in self._contacts:
            self._dynamics.add_contact(q, joint, force, tau)

    def _change(self, t: float) -> None:
        active = [row for row in self._faults if row["start"] <= t < row["end"]]
        self._contacts = [
            (int(row["joint"]), np.array([row["a"], row["b"], row["c"]]))
            for row in active
            if row["profile"] == CONTACT
        ]
        self._dynamics.carry(
            [
                (int(row["joint"]), float(row["a"]), np.array([row["b"], row["c"], row["d"]]))
                for row in active
                if row["profile"] == PAYLOAD
            ]
        )
        times = [float(row[name]) for row in self._faults for name in ("start", "end")]
        self._next = min((time for time in times if time > t), default=np.inf)


def check_outside(robot: Robot, faults: NDArray[np.void]) -> bool:
    """Return whether any fault acts on the arm as a whole.

    Args:
        robot: The robot.
        faults: From :func:`hil.faults.compile_faults`.

    Raises:
        InputError: One does, and the robot's closed form has no place for it.
    """
    found = [k for k, row in enumerate(faults) if row["profile"] in _KINDS]
    if found and robot.closed_form is not None:
        kind = _KINDS[int(faults[found[0]]["profile"])]
        raise InputError(
            f"fault[{found[0]}].kind",
            f"found '{kind}' with the closed-form plant '{robot.closed_form.name}'",
            "a kind that acts on joints",
        )
    return bool(found)
