"""What MIT drives and their controller say on one bus, for a DBC file.

All answers of a bus share one identifier: their first byte selects the drive. What is read from a
code of an answer is the middle of what it stands for, as the controller does. Frames that switch
a drive have the identifier and the length of its commands, so that they are told as one with
every field at its upper end.

Source: [katz2018].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from dftc_rt.bus.dbc import Message, Signal
from dftc_rt.cli.bus_database import CONTROLLER, message_names
from dftc_rt.config.robot import JointConfig
from dftc_rt.drives.mit import codec
from dftc_rt.drives.mit.scale import MitScale

DRIVES: Final = "Drives"


def mit_messages(
    joints: Sequence[JointConfig],
    prismatic: Sequence[bool],
    scales: Sequence[MitScale],
    cycle_ms: int | None,
) -> list[Message]:
    """Return the frames of one bus.

    Args:
        joints: Joints on the bus.
        prismatic: Which of them slide.
        scales: Their scales.
        cycle_ms: Period, where it is a whole number.
    """
    names = message_names(joints)
    rows = list(zip(names, joints, scales, prismatic, strict=True))
    node = Signal(
        "node", 0, 8, big_endian=True, selects=True,
        choices={joint.node_id: name for name, joint, *_ in rows},
    )  # fmt: skip
    fields = [
        field
        for name, joint, scale, linear in rows
        for field in _answer(name, joint, scale, linear)
    ]
    answers = Message(
        "Answers", scales[0].host_id, scales[0].answer_bytes, DRIVES, (node, *fields),
        "Answer of a drive to each frame that it gets",
    )  # fmt: skip
    return [answers, *(_command(*row, cycle_ms) for row in rows)]


def _command(
    name: str, joint: JointConfig, scale: MitScale, linear: bool, cycle_ms: int | None
) -> Message:
    """Commands to one drive; their codes are taken as they stand."""
    length, force = ("m", "N") if linear else ("rad", "Nm")
    codes, sign = (1 << codec.BITS) - 1, scale.sign
    p, v = 2.0 * scale.p_max / ((1 << codec.P_BITS) - 1), 2.0 * scale.v_max / codes
    t_max = scale.t_max * scale.torque_constant

    def field(name: str, start: int, bits: int, step: float, offset: float, unit: str) -> Signal:
        return Signal(name, start, bits, False, step, offset, unit, big_endian=True)

    return Message(
        f"{name}_command", joint.node_id, codec.COMMAND_BYTES, CONTROLLER,
        (
            field("position", 0, codec.P_BITS, sign * p,
                  -sign * scale.p_max - scale.zero_offset_rad, length),
            field("velocity", 16, codec.BITS, sign * v, -sign * scale.v_max, f"{length}/s"),
            field("kp", 28, codec.BITS, scale.kp_max / codes, 0.0, f"{force}/{length}"),
            field("kd", 40, codec.BITS, scale.kd_max / codes, 0.0, f"{force} s/{length}"),
            field("torque", 52, codec.BITS, sign * 2.0 * t_max / codes, -sign * t_max, force),
        ),
        f"Command to {joint.name}, node {joint.node_id}; FFh seven times and then FCh, FDh or FEh "
        "switches it",
        cycle_ms,
    )  # fmt: skip


def _answer(name: str, joint: JointConfig, scale: MitScale, linear: bool) -> list[Signal]:
    """Fields of one drive's answers."""
    length, force = ("m", "N") if linear else ("rad", "Nm")

    def field(
        what: str, start: int, bits: int, most: float, zero: float = 0.0, unit: str = ""
    ) -> Signal:
        step = 2.0 * most / ((1 << bits) - 1)
        return Signal(
            f"{name}_{what}", start, bits, False, scale.sign * step,
            scale.sign * (0.5 * step - most) - zero, unit, big_endian=True, when=joint.node_id,
        )  # fmt: skip

    fields = [
        field("position", 8, codec.P_BITS, scale.p_max, scale.zero_offset_rad, length),
        field("velocity", 24, codec.BITS, scale.v_max, unit=f"{length}/s"),
        field("torque", 36, codec.BITS, scale.t_max * scale.torque_constant, unit=force),
    ]
    if scale.answer_bytes == codec.LONG_ANSWER:
        for k, what in enumerate(("temperature", "error")):
            start = 48 + 8 * k
            plain = Signal(f"{name}_{what}", start, 8, big_endian=True, when=joint.node_id)
            fields.append(plain)
    return fields
