"""Whether a robot can have a closed form, which knows no locked joint and no armature."""

from __future__ import annotations

from collections.abc import Sequence

from dftc_rt.config.robot import JointConfig
from dftc_rt.dynamics.closed_form.plants import CLOSED_FORMS, ClosedForm
from dftc_rt.errors import InputError


def closed_form(name: str) -> ClosedForm:
    """Return a closed form by name.

    Raises:
        InputError: There is none of that name; lists those that there are.
    """
    if name not in CLOSED_FORMS:
        expected = "one of " + ", ".join(CLOSED_FORMS)
        raise InputError("robot.plant", f"found '{name}'", expected)
    return CLOSED_FORMS[name]


def check_fit(
    form: ClosedForm,
    drives: Sequence[JointConfig],
    lock: Sequence[str],
    gravity: Sequence[float] | None,
    where: str,
) -> None:
    """Refuse what the equations of a closed form have no place for.

    Args:
        form: The closed form.
        drives: Drive of each joint that is not locked.
        lock: Joints that the scenario locks.
        gravity: Gravity other than that of ``robot.toml``, (3,), m/s^2; None: none is given.
        where: The robot's file.

    Raises:
        InputError: A locked joint, armature, gravity, or another number of joints.
    """
    plant = f"closed-form plant '{form.name}'"
    if lock:
        found = f"found {', '.join(lock)} with the {plant}"
        raise InputError("robot.lock", found, "no locked joint")
    if gravity is not None:
        raise InputError("robot.gravity_m_s2", f"found with the {plant}", "none: it has its own")
    if len(drives) != form.n:
        raise InputError(f"{where}: plant", f"{len(drives)} joints", f"{form.n} for the {plant}")
    for drive in drives:
        if drive.armature != 0.0:
            found = f"joint '{drive.name}' has {drive.armature:g} with the {plant}"
            raise InputError(f"{where}: armature", found, "armature = 0")
