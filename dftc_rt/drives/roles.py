"""Who says what on a bus: an identifier, read with a profile's rules.

Source: CiA 301, "Pre-defined connection set"; docs/profiles.md for ``mit`` and ``moteus``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from dftc_rt.bus.frame import BARRIER_ID, EFF_FLAG, EFF_MASK
from dftc_rt.config.scenario import BusTable
from dftc_rt.drives.cia402 import objects as od

Speaker = Literal["drive", "controller", "unknown"]

_NODE: Final = 0x7F
_FROM_DRIVE: Final = {
    od.EMCY: "EMCY",
    **{base: f"TPDO{k}" for k, base in enumerate(od.TPDO, start=1)},
    od.SDO_RESPONSE: "SDO response",
    od.HEARTBEAT: "heartbeat",
}
_TO_DRIVE: Final = {
    **{base: f"RPDO{k}" for k, base in enumerate(od.RPDO, start=1)},
    od.SDO_REQUEST: "SDO request",
}


@dataclass(frozen=True, slots=True)
class Role:
    """What a frame is.

    Attributes:
        speaker: Who sends it: a drive of the robot, a controller of these drives, or neither.
        what: In words.
        joint: Joint whose drive sends it, "" when the identifier alone does not tell.
        node: Node id that sends it, where it is no drive of this bus; 0 when not told.
    """

    speaker: Speaker
    what: str
    joint: str = ""
    node: int = 0


def role_of(table: BusTable, can_id: int, joints: Mapping[int, str]) -> Role:
    """Return what an identifier is on one bus.

    Args:
        table: The scenario's ``[bus]``.
        can_id: Identifier with flags.
        joints: Node id -> joint, of this bus.
    """
    if can_id == BARRIER_ID:
        return Role("controller", "barrier of a lock-step run")
    if table.profile == "mit":
        return _mit(table.mit.host_id, can_id, joints)
    if table.profile == "moteus":
        return _moteus(table.moteus.host_id, can_id, joints)
    return _cia402(can_id, joints)


def _cia402(can_id: int, joints: Mapping[int, str]) -> Role:
    if can_id == od.NMT:
        return Role("controller", "NMT command")
    if can_id == od.SYNC:
        return Role("controller", "SYNC")
    if can_id == od.HEARTBEAT + od.MASTER_NODE_ID:
        return Role("controller", f"heartbeat of node {od.MASTER_NODE_ID}, which is ours")
    base, node = can_id & ~_NODE, can_id & _NODE
    kind = _FROM_DRIVE.get(base) or _TO_DRIVE.get(base)
    if kind is None or not node:
        return Role("unknown", "")
    joint = joints.get(node)
    if joint is None:
        return Role("unknown", f"{kind}, node {node}", node=node if base in _FROM_DRIVE else 0)
    if base in _TO_DRIVE:
        return Role("controller", f"{kind} to {joint}")
    return Role("drive", f"{kind} of {joint}", joint)


def _mit(host_id: int, can_id: int, joints: Mapping[int, str]) -> Role:
    if can_id == host_id:
        return Role("drive", "answers")
    if can_id in joints:
        return Role("controller", f"command to {joints[can_id]}")
    return Role("unknown", "")


def _moteus(host_id: int, can_id: int, joints: Mapping[int, str]) -> Role:
    number = can_id & (EFF_MASK if can_id & EFF_FLAG else 0x7FF)
    source, target = number >> 8 & _NODE, number & _NODE
    if number >> 16 or number & 0x80:
        return Role("unknown", "")
    if source in joints:
        other = "" if target == host_id else f" to host {target}"
        return Role("drive", f"answer of {joints[source]}{other}", joints[source])
    if target in joints:
        return Role("controller", f"host {source} to {joints[target]}")
    return Role("unknown", f"node {source} to node {target}", node=source)
