"""The floor of the plant's speed: bare MuJoCo steps of the same robot.

Geometry, limits, damping and friction are taken out of the URDF and locked joints are
welded, so that what is left is what the plant computes too: forward dynamics of the same
degrees of freedom.
"""

from __future__ import annotations

import math
import statistics
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dftc_rt.errors import EnvironmentLacksError

_AXIS_DEFAULT = "1 0 0"


@dataclass(frozen=True)
class Floor:
    """Time of bare steps.

    Attributes:
        step_us: One ``mj_step``, median over blocks.
        cycle_us: All steps of one cycle.
        joints: Degrees of freedom of the model.
    """

    step_us: float
    cycle_us: float
    joints: int


def strip(urdf: str, locked: Mapping[str, float]) -> str:
    """Return a URDF with masses and joints only; ``locked`` joints are fixed.

    Args:
        urdf: Text of a URDF.
        locked: Joints to weld, and where, rad (m).

    Raises:
        ValueError: A joint to weld is not in the URDF.
    """
    root = ET.fromstring(urdf)
    for tag in ("transmission", "gazebo", "mujoco", "material", "ros2_control"):
        for element in root.findall(tag):
            root.remove(element)
    for link in root.findall("link"):
        for element in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(element)
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    if missing := set(locked) - set(joints):
        raise ValueError(f"no joint {', '.join(sorted(missing))} in the URDF")
    for name, joint in joints.items():
        if name in locked:
            _weld(joint, locked[name])
        for tag in ("dynamics", "limit", "mimic", "safety_controller", "calibration"):
            for element in joint.findall(tag):
                joint.remove(element)
        if joint.get("type") == "revolute":  # which would need its limit
            joint.set("type", "continuous")
    extension = ET.SubElement(root, "mujoco")
    ET.SubElement(
        extension, "compiler",
        balanceinertia="false", fusestatic="true", strippath="true", autolimits="true",
    )  # fmt: skip
    return ET.tostring(root, encoding="unicode")


def _weld(joint: ET.Element, position: float) -> None:
    """Make a joint fixed where it stands at ``position``, rad (m)."""
    axis_element, origin = joint.find("axis"), joint.find("origin")
    text = _AXIS_DEFAULT if axis_element is None else axis_element.get("xyz", _AXIS_DEFAULT)
    axis = np.array([float(v) for v in text.split()])
    axis /= np.linalg.norm(axis)
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    offset = np.array([float(v) for v in origin.get("xyz", "0 0 0").split()])
    rotation = _from_rpy([float(v) for v in origin.get("rpy", "0 0 0").split()])
    if joint.get("type") == "prismatic":
        offset = offset + rotation @ axis * position
    else:
        rotation = rotation @ _about(axis, position)
    origin.set("xyz", " ".join(repr(float(v)) for v in offset))
    origin.set("rpy", " ".join(repr(v) for v in _to_rpy(rotation)))
    joint.set("type", "fixed")


def _about(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Rotation by ``angle`` about a unit ``axis``, (3, 3); Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: NDArray[np.float64] = (
        np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    )
    return rotation


def _from_rpy(rpy: list[float]) -> NDArray[np.float64]:
    roll, pitch, yaw = (_about(np.eye(3)[i], angle) for i, angle in enumerate(rpy))
    rotation: NDArray[np.float64] = yaw @ pitch @ roll
    return rotation


def _to_rpy(r: NDArray[np.float64]) -> tuple[float, float, float]:
    pitch = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    if math.hypot(r[0, 0], r[1, 0]) < 1e-9:  # looking straight up or down: put all into yaw
        return 0.0, pitch, math.atan2(-r[0, 1], r[1, 1])
    return math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])


def compile_model(
    urdf: str,
    locked: Mapping[str, float],
    step_s: float = 0.25e-3,
    armature: NDArray[np.float64] | None = None,
) -> Any:
    """Return the ``mujoco.MjModel`` of a stripped URDF.

    Args:
        urdf: Text of a URDF.
        locked: Joints to weld, and where, rad (m).
        step_s: Integration step.
        armature: (n,) kg m^2 (kg), in MuJoCo's joint order; None: zero.

    Raises:
        EnvironmentLacksError: MuJoCo is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise EnvironmentLacksError("no MuJoCo", "pip install 'dftc_rt[bench]'") from error
    model = mujoco.MjModel.from_xml_string(strip(urdf, locked))
    model.opt.timestep = step_s
    if armature is not None:
        model.dof_armature[:] = armature
    return model


def steps(model: Any, q: NDArray[np.float64], substeps: int = 4) -> Callable[[int], None]:
    """Return a function that makes ``substeps`` bare steps a cycle.

    It starts from the pose ``q`` each time it is called, held by the torque that balances
    it, and returns to it every 100 cycles, so that nothing runs away.

    Args:
        model: From :func:`compile_model`.
        q: (n,) rad (m), in MuJoCo's joint order.
        substeps: Steps of one cycle.
    """
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    held = data.qfrc_bias.copy()

    def run(cycles: int) -> None:
        step = mujoco.mj_step
        for k in range(cycles):
            if k % 100 == 0:
                mujoco.mj_resetData(model, data)
                data.qpos[:] = q
                data.qfrc_applied[:] = held
            step(model, data, nstep=substeps)

    return run


def measure(model: Any, q: NDArray[np.float64], substeps: int = 4, cycles: int = 5000) -> Floor:
    """Time :func:`steps` in blocks of 100 cycles.

    Args:
        model: From :func:`compile_model`.
        q: (n,) rad (m), in MuJoCo's joint order.
        substeps: Steps of one cycle.
        cycles: Cycles to time.
    """
    run = steps(model, q, substeps)
    blocks = []
    for _ in range(max(cycles // 100, 1)):
        start = time.perf_counter_ns()
        run(100)
        blocks.append((time.perf_counter_ns() - start) / 100e3)
    cycle_us = statistics.median(blocks)
    return Floor(cycle_us / substeps, cycle_us, model.nv)
