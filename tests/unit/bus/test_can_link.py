"""What a CAN driver says over rtnetlink; bytes by hand from linux/can/netlink.h."""

from __future__ import annotations

import struct

from dftc_rt.bus.can_link import CanLink, decode_can_link
from dftc_rt.bus.rtnetlink import parse_link


def attribute(kind: int, value: bytes) -> bytes:
    return struct.pack("=HH", 4 + len(value), kind) + value + b"\0" * (-len(value) % 4)


def u32(value: int) -> bytes:
    return struct.pack("=I", value)


# 1 Mbit/s of a 80 MHz clock: 10 quanta of 100 ns, sampled at 87.5 %
TIMING = struct.pack("=8I", 1_000_000, 875, 100, 3, 4, 2, 1, 8)
DATA = struct.pack("=8I", 5_000_000, 750, 25, 2, 3, 2, 1, 2)
CAN = (
    attribute(1, TIMING)
    + attribute(4, u32(2))  # CAN_STATE_ERROR_PASSIVE
    + attribute(5, struct.pack("=II", 0x3F, 0x12))  # LISTENONLY | BERR_REPORTING
    + attribute(6, u32(100))
    + attribute(8, struct.pack("=HH", 128, 5))
    + attribute(9, DATA)
)
# struct ifinfomsg: family, type ARPHRD_CAN, index 3, IFF_UP
LINK = (
    struct.pack("=BxHiII", 0, 280, 3, 1, 0)
    + attribute(3, b"can0\0")
    + attribute(4, u32(72))
    + attribute(13, u32(10))
    + attribute(18, attribute(1, b"can\0") + attribute(2, CAN))
)


def test_all_of_a_real_interface() -> None:
    link = parse_link(LINK)
    assert (link.index, link.kind, link.up, link.mtu, link.queue) == (3, "can", True, 72, 10)
    assert decode_can_link(link.data) == CanLink(
        bitrate=1_000_000,
        sample_point=0.875,
        data_bitrate=5_000_000,
        state="error passive",
        modes=("listen-only", "berr-reporting"),
        restart_ms=100,
        tec=128,
        rec=5,
    )


def test_a_link_that_tells_nothing() -> None:
    assert decode_can_link(b"") == CanLink()


def test_a_state_of_a_later_kernel() -> None:
    assert decode_can_link(attribute(4, u32(17))).state == ""
