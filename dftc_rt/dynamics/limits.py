"""Joint limits of a URDF, and what holds where it states none.

| limit | stated as | taken for "none" | then |
|---|---|---|---|
| position | lower, upper | continuous; both equal to 0; beyond 1e6 | -inf, inf |
| velocity | velocity | 0 or infinite | inf |
| torque | effort | 0 or infinite | 100 Nm, prismatic 500 N, marked as assumed |
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from dftc_rt.dynamics.urdf import Urdf
from dftc_rt.errors import InputError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

ASSUMED_TORQUE_NM: Final = 100.0
ASSUMED_FORCE_N: Final = 500.0
UNLIMITED_POSITION: Final = 1e6


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of n joints.

    Attributes:
        joints: Names.
        lower: (n,) rad (m).
        upper: (n,) rad (m).
        velocity: (n,) rad/s (m/s).
        torque: (n,) Nm (N).
        torque_assumed: (n,) the URDF states no torque limit.
        continuous: (n,)
        prismatic: (n,)
    """

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    torque: Array
    torque_assumed: Mask
    continuous: Mask
    prismatic: Mask

    def take(self, joints: Sequence[str]) -> JointLimits:
        """Limits of some of the joints, in the order given."""
        index = np.array([self.joints.index(name) for name in joints], dtype=np.intp)
        arrays = {
            key: value[index] for key, value in vars(self).items() if isinstance(value, np.ndarray)
        }
        for array in arrays.values():
            array.setflags(write=False)
        return JointLimits(joints=tuple(joints), **arrays)

    def neutral(self) -> Array:
        """(n,) 0 where within limits; else mid-range, or the one limit that there is."""
        both = np.isfinite(self.lower) & np.isfinite(self.upper)
        middle = 0.5 * (np.where(both, self.lower, 0.0) + np.where(both, self.upper, 0.0))
        nearest = np.clip(0.0, self.lower, self.upper)
        return np.where(both & (nearest != 0.0), middle, nearest)

    def check(self, q: Array, where: str) -> None:
        """Refuse positions that are not finite or not within limits.

        Raises:
            InputError: Names the first such joint.
        """
        for i, name in enumerate(self.joints):
            if not self.lower[i] <= q[i] <= self.upper[i] or not np.isfinite(q[i]):
                limits = f"{self.lower[i]:g} to {self.upper[i]:g}"
                raise InputError(where, f"joint '{name}' at {q[i]:g}", f"within limits, {limits}")


def joint_limits(model: Any, urdf: Urdf) -> JointLimits:
    """Read the limits of all joints of a model that was built from ``urdf``.

    Raises:
        InputError: A lower limit above the upper, or equal to it and not both 0.
    """
    names = tuple(model.names)[1:]
    types = {joint.name: joint.type for joint in urdf.joints}
    idx_q = np.array(tuple(model.idx_qs)[1:], dtype=np.intp)
    continuous = np.array([types[name] == "continuous" for name in names])
    prismatic = np.array([types[name] == "prismatic" for name in names])
    lower = np.array(model.lowerPositionLimit)[idx_q]
    upper = np.array(model.upperPositionLimit)[idx_q]
    unlimited = continuous | ((lower == 0.0) & (upper == 0.0))
    for i, name in enumerate(names):
        if not unlimited[i] and not lower[i] < upper[i]:
            found = f"joint '{name}' has limits {lower[i]:g} to {upper[i]:g}"
            raise InputError(str(urdf.path), found, "lower below upper")
    # lowerVelocityLimit comes back positive from a URDF: only the upper ones are usable.
    velocity = np.array(model.upperVelocityLimit)
    torque = np.array(model.upperEffortLimit)
    no_torque = ~((torque > 0.0) & (torque < np.inf))
    return JointLimits(
        joints=names,
        lower=np.where(unlimited | (lower < -UNLIMITED_POSITION), -np.inf, lower),
        upper=np.where(unlimited | (upper > UNLIMITED_POSITION), np.inf, upper),
        velocity=np.where(velocity > 0.0, velocity, np.inf),
        torque=np.where(no_torque, np.where(prismatic, ASSUMED_FORCE_N, ASSUMED_TORQUE_NM), torque),
        torque_assumed=no_torque,
        continuous=continuous,
        prismatic=prismatic,
    )
