"""Whose an identifier is; by hand from CiA 301 and docs/profiles.md."""

from __future__ import annotations

import pytest

from dftc_rt.bus.frame import BARRIER_ID, EFF_FLAG
from dftc_rt.config.scenario import BusTable
from dftc_rt.drives.roles import role_of

JOINTS = {1: "shoulder", 5: "elbow"}


def said(profile: str, can_id: int) -> tuple[str, str, str, int]:
    role = role_of(BusTable(profile=profile), can_id, JOINTS)  # type: ignore[arg-type]
    return role.speaker, role.what, role.joint, role.node


@pytest.mark.parametrize(
    ("can_id", "role"),
    [
        (0x000, ("controller", "NMT command", "", 0)),
        (0x080, ("controller", "SYNC", "", 0)),
        (0x081, ("drive", "EMCY of shoulder", "shoulder", 0)),
        (0x185, ("drive", "TPDO1 of elbow", "elbow", 0)),
        (0x481, ("drive", "TPDO4 of shoulder", "shoulder", 0)),
        (0x205, ("controller", "RPDO1 to elbow", "", 0)),
        (0x585, ("drive", "SDO response of elbow", "elbow", 0)),
        (0x605, ("controller", "SDO request to elbow", "", 0)),
        (0x701, ("drive", "heartbeat of shoulder", "shoulder", 0)),
        (0x77F, ("controller", "heartbeat of node 127, which is ours", "", 0)),
        (0x709, ("unknown", "heartbeat, node 9", "", 9)),
        (0x209, ("unknown", "RPDO1, node 9", "", 0)),
        (0x100, ("unknown", "", "", 0)),
        (0x7E5, ("unknown", "", "", 0)),
        (EFF_FLAG | 0x181, ("unknown", "", "", 0)),
    ],
)
def test_cia402(can_id: int, role: tuple[str, str, str, int]) -> None:
    assert said("cia402", can_id) == role


def test_mit() -> None:
    assert said("mit", 0) == ("drive", "answers", "", 0)
    assert said("mit", 5) == ("controller", "command to elbow", "", 0)
    assert said("mit", 6) == ("unknown", "", "", 0)


def test_moteus() -> None:
    # source << 8 | target, 8000h where an answer is asked for
    assert said("moteus", 0x500) == ("drive", "answer of elbow", "elbow", 0)
    assert said("moteus", 0x510) == ("drive", "answer of elbow to host 16", "elbow", 0)
    assert said("moteus", EFF_FLAG | 0x8005) == ("controller", "host 0 to elbow", "", 0)
    assert said("moteus", 0x1001 | EFF_FLAG) == ("controller", "host 16 to shoulder", "", 0)
    assert said("moteus", 0x700) == ("unknown", "node 7 to node 0", "", 7)
    assert said("moteus", EFF_FLAG | 0x10005) == ("unknown", "", "", 0)


def test_a_lock_step_run_is_a_controller() -> None:
    assert said("cia402", BARRIER_ID)[0] == "controller"
