"""From the fits to a calibration file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
import tomli_w
from numpy.typing import NDArray

from dftc_rt.calibration.regression import Fit
from dftc_rt.calibration.residuals import Spread
from dftc_rt.config.calibration import Calibration, JointCalibration, LinkLoad
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.regressor import last_joints

F64 = NDArray[np.float64]

_DIGITS = 6


def calibration_of(robot: Robot, fit: Fit, source: str, seconds: float) -> Calibration:
    """Calibration of the model alone, without settings of the estimator."""
    links = tuple(
        _link(robot.joints[index], fit.load[row], fit.load_std[row])
        for row, index in enumerate(last_joints(robot))
    )

    def numbers(i: int) -> dict[str, Any]:
        values = {key: _round(each[i]) for key, each in fit.values.items()}
        return values | {f"{key}_std": _round(each[i]) for key, each in fit.std.items()}

    joints = tuple(
        JointCalibration(
            name=name,
            not_excited=fit.not_excited[i],
            **numbers(i),
        )
        for i, name in enumerate(robot.joints)
    )
    return Calibration(
        robot=robot.name, source=source, seconds=_round(seconds), link=links, joint=joints
    )


def _link(joint: str, values: F64, std: F64) -> LinkLoad:
    mass, mx, my, mz, xx, xy, yy, xz, yz, zz = (_round(value) for value in values)
    return LinkLoad(
        joint=joint,
        mass_kg=mass,
        mass_std_kg=_round(std[0]),
        first_moment_kg_m=(mx, my, mz),
        inertia_kg_m2=(xx, xy, yy, xz, yz, zz),
    )


def with_statistics(
    calibration: Calibration,
    spreads: Sequence[Spread],
    torque_limit: F64,
    held_out: Sequence[float],
    thresholds: Sequence[dict[str, float]],
    false_alarms_per_hour: float,
) -> Calibration:
    """The same with the settings of the estimator that the residual asks for.

    Args:
        calibration: The model.
        spreads: One a joint.
        torque_limit: (n,), Nm.
        held_out: RMS residual of each joint on motion that was not fitted, percent of the limit.
        thresholds: Thresholds of each joint, by setting.
        false_alarms_per_hour: For which they were chosen, the whole robot.
    """
    joints = tuple(
        msgspec.structs.replace(
            joint,
            gains={
                "attribution": 1.0,  # competing explanations: they need a trusted variance
                "floor_nm": _round(each.floor_nm),
                "floor_fraction": 0.0,
                "velocity_noise": _round(each.velocity_noise),
                "sigma_acc": _round(each.sigma_acc),
                "sigma_bias": _round(each.sigma_bias),
                "sigma_friction": _round(each.friction_nm / limit),
                "v_friction": _round(each.v_friction),
                "inflation": _round(each.inflation),
                **{key: _round(value) for key, value in own.items()},
            },
        )
        for joint, each, limit, own in zip(
            calibration.joint, spreads, torque_limit, thresholds, strict=True
        )
    )
    return msgspec.structs.replace(
        calibration,
        joint=joints,
        held_out_percent=tuple(_round(value) for value in held_out),
        false_alarms_per_hour=false_alarms_per_hour,
    )


def to_toml(calibration: Calibration) -> str:
    """Text of a calibration file."""
    content = {k: v for k, v in msgspec.to_builtins(calibration).items() if v is not None}
    return (
        "# Written by `dftc calibrate`. Units: Nm, Nm s/rad, kg m²; *_std are standard errors.\n"
        "# torque_constant is the true over the nominal one.\n" + tomli_w.dumps(content)
    )


def _round(value: float) -> float:
    """Six significant digits: more is noise, and people read this."""
    return float(f"{float(value):.{_DIGITS}g}")
