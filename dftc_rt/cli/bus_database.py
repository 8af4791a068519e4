"""What CiA 402 drives and their controller say on one bus, for a DBC file.

Positions, velocities and torques are in joint units. A position on the wire is an int32
that wraps; the controller carries it on, a DBC cannot.

Source: CiA 301 (NMT, SYNC, EMCY, SDO, heartbeat), CiA 402-2 (objects), and the PDOs of
``dftc_rt.drives.cia402.mapping``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from dftc_rt.bus.dbc import Message, Signal
from dftc_rt.config.robot import JointConfig
from dftc_rt.drives.cia402 import objects as od
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.scale import RAD_PER_COUNT, TORQUE_PER_COUNT, ZERO_OFFSET, ScaleTable

CONTROLLER: Final = "Controller"

_NMT_COMMANDS: Final = {
    od.NMT_START: "start",
    od.NMT_STOP: "stop",
    od.NMT_PRE_OPERATIONAL: "enter pre-operational",
    od.NMT_RESET_NODE: "reset node",
    od.NMT_RESET_COMMUNICATION: "reset communication",
}
_NMT_STATES: Final = {
    od.BOOT_UP: "boot-up",
    od.STOPPED: "stopped",
    od.OPERATIONAL: "operational",
    od.PRE_OPERATIONAL: "pre-operational",
}
_CONTROLWORDS: Final = {
    states.CW_DISABLE_VOLTAGE: "disable voltage",
    states.CW_QUICK_STOP: "quick stop",
    states.CW_SHUTDOWN: "shutdown",
    states.CW_SWITCH_ON: "switch on",
    states.CW_ENABLE_OPERATION: "enable operation",
    states.CW_FAULT_RESET: "fault reset",
}
_ERROR_CODES: Final = {
    od.EMCY_RESET: "reset or no error",
    od.EMCY_COMMUNICATION: "communication",
    od.EMCY_HEARTBEAT_LOST: "heartbeat lost",
    od.EMCY_PDO_LENGTH: "PDO length",
    od.EMCY_RPDO_TIMEOUT: "RPDO timeout",
}
# Bits of the statusword (CiA 402-2, object 6041h).
_STATUS_BITS: Final = (
    "ready_to_switch_on", "switched_on", "operation_enabled", "fault", "voltage_enabled",
    "no_quick_stop", "switch_on_disabled", "warning", "manufacturer_8", "remote",
    "target_reached", "internal_limit_active", "follows_command", "mode_13",
    "manufacturer_14", "manufacturer_15",
)  # fmt: skip


def bus_messages(
    joints: Sequence[JointConfig],
    prismatic: Sequence[bool],
    scales: ScaleTable,
    rate_hz: float,
) -> list[Message]:
    """Return the frames of one bus.

    Args:
        joints: Joints on the bus.
        prismatic: Which of them slide.
        scales: Their scales.
        rate_hz: Cycles per second.
    """
    period_ms = cycle_ms(rate_hz)
    messages = [
        Message(
            "NMT", od.NMT, 2, CONTROLLER,
            (Signal("command", 0, 8, choices=_NMT_COMMANDS), Signal("node", 8, 8)),
            "Network management; node 0 is every node",
        ),
        Message(
            "SYNC", od.SYNC, 1, CONTROLLER, (Signal("counter", 0, 8),),
            "Every cycle; drives latch, act on the last command, and answer", period_ms,
        ),
        Message(
            "Controller_heartbeat", od.HEARTBEAT + od.MASTER_NODE_ID, 1, CONTROLLER,
            (Signal("state", 0, 8, choices=_NMT_STATES),), "The drives stop without it",
            od.MASTER_HEARTBEAT_MS,
        ),
    ]  # fmt: skip
    names = message_names(joints)
    for k, joint in enumerate(joints):
        linear = prismatic[k]
        messages += _drive(names[k], joint, scales.values[:, k].tolist(), linear, period_ms)
    return messages


def cycle_ms(rate_hz: float) -> int | None:
    """Return the period in ms; None where that is no whole number."""
    period_ms = 1000.0 / rate_hz
    return round(period_ms) if period_ms.is_integer() else None


def message_names(joints: Sequence[JointConfig]) -> list[str]:
    """Return a name for each drive, with letters, digits and ``_`` only; all different."""
    plain = [re.sub(r"[^A-Za-z0-9_]", "_", joint.name) for joint in joints]
    named = [name if re.match("[A-Za-z_]", name) else f"joint_{name}" for name in plain]
    taken = [CONTROLLER, *named]
    return [
        name if taken.count(name) == 1 else f"{name}_node{joint.node_id}"
        for name, joint in zip(named, joints, strict=True)
    ]


def _drive(
    name: str, joint: JointConfig, scale: list[float], linear: bool, period_ms: int | None
) -> list[Message]:
    """Frames from and to one drive."""
    length, force = ("m", "N") if linear else ("rad", "Nm")
    per_count, torque = scale[RAD_PER_COUNT], scale[TORQUE_PER_COUNT]
    node, about = joint.node_id, f"{joint.name}, node {joint.node_id}"
    position = Signal("position", 0, 32, True, per_count, 0.0 - scale[ZERO_OFFSET], length)
    velocity = Signal("velocity", 32, 32, True, per_count, unit=f"{length}/s")
    status = tuple(Signal(bit, place, 1) for place, bit in enumerate(_STATUS_BITS))
    slow = None if period_ms is None else period_ms * od.TORQUE_ACTUAL_EVERY
    return [
        Message(
            f"{name}_EMCY", od.EMCY + node, 8, name,
            (Signal("error_code", 0, 16, choices=_ERROR_CODES), Signal("error_register", 16, 8),
             Signal("manufacturer", 24, 40)),
            f"Emergency of {about}",
        ),
        Message(
            f"{name}_TPDO1", od.TPDO[0] + node, 8, name, (position, velocity),
            f"Position 6064h and velocity 606Ch of {about}, answer to every SYNC", period_ms,
        ),
        Message(
            f"{name}_RPDO1", od.RPDO[0] + node, 4, CONTROLLER,
            (Signal("controlword", 0, 16, choices=_CONTROLWORDS),
             Signal("target_torque", 16, 16, True, torque, unit=force)),
            f"Controlword 6040h and target torque 6071h for {about}, in force from the next SYNC",
            period_ms,
        ),
        Message(
            f"{name}_TPDO2", od.TPDO[1] + node, 3, name,
            (*status, Signal("mode", 16, 8, True, choices={od.CST: "cyclic synchronous torque"})),
            f"Statusword 6041h and mode 6061h of {about}, when they change",
        ),
        Message(
            f"{name}_TPDO3", od.TPDO[2] + node, 2, name,
            (Signal("torque_actual", 0, 16, True, torque, unit=force),),
            f"Torque actual 6077h of {about}, every tenth SYNC", slow,
        ),
        _sdo(f"{name}_SDO_response", od.SDO_RESPONSE + node, name, f"SDO from {about}"),
        _sdo(f"{name}_SDO_request", od.SDO_REQUEST + node, CONTROLLER, f"SDO to {about}"),
        Message(
            f"{name}_heartbeat", od.HEARTBEAT + node, 1, name,
            (Signal("state", 0, 8, choices=_NMT_STATES),), f"Heartbeat of {about}",
        ),
    ]  # fmt: skip


def _sdo(name: str, can_id: int, sender: str, comment: str) -> Message:
    """One direction of an SDO channel; a segment's bytes are not told apart."""
    fields = (
        Signal("specifier", 0, 8),
        Signal("index", 8, 16),
        Signal("subindex", 24, 8),
        Signal("data", 32, 32),
    )
    return Message(name, can_id, 8, sender, fields, comment)
