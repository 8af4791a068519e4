"""What moteus drives and their controller say on one bus, for a DBC file.

The protocol lets every frame hold any registers in any format. A DBC knows one layout for an
identifier, so it is that of the controller's cycle (:mod:`dftc_rt.drives.moteus.codec`): its
third byte tells torque, stop and question apart, and an answer has what each of them asks for.
What somebody else asks of the same drive is told wrongly.

Source: [moteus].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from dftc_rt.bus.dbc import Message, Signal
from dftc_rt.bus.frame import EFF_FLAG
from dftc_rt.cli.bus_database import CONTROLLER, message_names
from dftc_rt.config.robot import JointConfig
from dftc_rt.drives.moteus import codec
from dftc_rt.drives.moteus import registers as reg
from dftc_rt.drives.moteus.scale import TORQUE_STEP, MoteusScale

_COMMAND_BYTES: Final = 24
_ANSWER_BYTES: Final = 16
_QUESTION: Final = 0x1D  # what stands at the place of the mode where none is written
_WRITTEN: Final = {reg.STOPPED: "stop", reg.IN_POSITION: "torque", _QUESTION: "question"}
_MODES: Final = {
    reg.STOPPED: "stopped",
    reg.FAULTED: "fault",
    reg.IN_POSITION: "position",
    reg.TIMED_OUT: "timeout",
}


def moteus_messages(
    joints: Sequence[JointConfig],
    prismatic: Sequence[bool],
    scales: Sequence[MoteusScale],
    cycle_ms: int | None,
) -> list[Message]:
    """Return the frames of one bus.

    Args:
        joints: Joints on the bus.
        prismatic: Which of them slide.
        scales: Their scales.
        cycle_ms: Period, where it is a whole number.
    """
    found = []
    for name, joint, scale, linear in zip(
        message_names(joints), joints, scales, prismatic, strict=True
    ):
        found += [
            _command(name, joint, scale, linear, cycle_ms),
            _answer(name, joint, scale, linear, cycle_ms),
        ]
    return found


def _command(
    name: str, joint: JointConfig, scale: MoteusScale, linear: bool, cycle_ms: int | None
) -> Message:
    """Frames to one drive."""
    fraction = float(reg.STEPS[reg.FRACTION, reg.INT8])
    seconds = float(reg.STEPS[reg.SECONDS, reg.INT8])
    torque = scale.sign * TORQUE_STEP * scale.torque_constant
    mode = reg.IN_POSITION
    return Message(
        f"{name}_command",
        codec.REPLY_BIT | scale.host_id << 8 | joint.node_id | EFF_FLAG,
        _COMMAND_BYTES, CONTROLLER,
        (
            Signal("frame", 16, 8, selects=True, choices=_WRITTEN),
            Signal("torque", 72, 16, True, torque, unit="N" if linear else "Nm", when=mode),
            Signal("kp_scale", 104, 8, True, fraction, when=mode),
            Signal("kd_scale", 112, 8, True, fraction, when=mode),
            Signal("timeout", 136, 8, True, seconds, unit="s", when=mode),
        ),
        f"Frame to {joint.name}, node {joint.node_id}: 24 bytes with a torque, 12 to stop, 8 ask",
        cycle_ms, fd=True,
    )  # fmt: skip


def _answer(
    name: str, joint: JointConfig, scale: MoteusScale, linear: bool, cycle_ms: int | None
) -> Message:
    """Answers of one drive."""
    length, force = ("m", "N") if linear else ("rad", "Nm")
    turn = scale.sign * math.tau
    velocity = turn * float(reg.STEPS[reg.REVOLUTIONS_PER_S, reg.INT16])
    torque = scale.sign * TORQUE_STEP * scale.torque_constant
    number = joint.node_id << 8 | scale.host_id
    return Message(
        f"{name}_answer", number | EFF_FLAG if number > 0x7FF else number, _ANSWER_BYTES, name,
        (
            Signal("mode", 16, 8, True, choices=_MODES),
            Signal("position", 40, 32, True, turn, 0.0 - scale.zero_offset_rad, length, real=True),
            Signal("velocity", 88, 16, True, velocity, unit=f"{length}/s"),
            Signal("torque", 104, 16, True, torque, unit=force),
        ),
        f"Answer of {joint.name}, node {joint.node_id}; with 20 bytes a fault code follows",
        cycle_ms, fd=True,
    )  # fmt: skip
