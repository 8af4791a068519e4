"""SDO transfers that are not expedited: segments, their order, and what ends them.

Frames by hand from CiA 301, "SDO protocols".
"""

from __future__ import annotations

import pytest

from hil.drive import slots
from tests.unit.drives.drive_bus import DriveBus, drives_of, read, scales

NAME = b"CiA 402 torque drive"  # 1008h, 20 bytes
TOGGLE, TIMED_OUT, UNKNOWN = (
    "00000305",
    "00000405",
    "01000405",
)  # 0503_0000h, 0504_000xh on the wire
READ_ONLY, LENGTH, LONG = "02000106", "10000706", "12000706"


@pytest.fixture
def bus() -> DriveBus:
    return DriveBus(drives_of(scales(1)))


def ask(bus: DriveBus, request: str) -> str:
    """Send one request; return the answer's bytes in hex."""
    [(can_id, data)] = bus.exchange((0x601, bytes.fromhex(request)))
    assert can_id == 0x581
    return data.hex()


def test_a_string_is_uploaded_in_segments(bus: DriveBus) -> None:
    assert ask(bus, "4008100000000000") == "4108100014000000"  # 20 bytes will come
    found = b""
    for request, head in (("60", 0x00), ("70", 0x10), ("60", 0x03)):  # last: 1 byte unused
        answer = bytes.fromhex(ask(bus, request + 14 * "0"))
        assert answer[0] == head
        found += answer[1 : 8 - (head >> 1 & 7)]
    assert found == NAME
    assert ask(bus, "70" + 14 * "0")[-8:] == UNKNOWN  # it is over


def test_a_block_upload_becomes_one_in_segments(bus: DriveBus) -> None:
    assert ask(bus, "a408100000000000") == "4108100014000000"


def test_segments_of_no_transfer_are_refused(bus: DriveBus) -> None:
    assert ask(bus, "6000000000000000") == "80000000" + UNKNOWN
    assert ask(bus, "0b34120000000000") == "80000000" + UNKNOWN
    assert ask(bus, "2171600002000000") == "6071600000000000"  # a download is open
    assert ask(bus, "6000000000000000") == "80716000" + UNKNOWN


def test_a_wrong_toggle_bit_ends_the_transfer(bus: DriveBus) -> None:
    ask(bus, "4008100000000000")
    assert ask(bus, "7000000000000000") == "80081000" + TOGGLE
    assert ask(bus, "6000000000000000")[-8:] == UNKNOWN


@pytest.mark.parametrize(
    ("request_", "abort"),
    [
        ("2141600002000000", READ_ONLY),  # statusword
        ("2108100004000000", READ_ONLY),  # device name, const
        ("2171600004000000", LENGTH),  # four bytes for two
        ("2199990004000000", "00000206"),  # no such object
        ("2118100904000000", "11000906"),  # no such sub-index
    ],
)
def test_a_download_is_refused_before_its_segments(
    bus: DriveBus, request_: str, abort: str
) -> None:
    assert ask(bus, request_) == "80" + request_[2:8] + abort


def test_a_download_of_unknown_size_that_grows_too_long_is_refused(bus: DriveBus) -> None:
    assert ask(bus, "2071600000000000") == "6071600000000000"
    assert ask(bus, "0011223344556677")[-8:] == LONG
    assert bus.drives.objects[0, slots.TARGET_TORQUE] == 0


def test_a_transfer_that_the_client_leaves_times_out_in_rig_time(bus: DriveBus) -> None:
    bus.drives.tick(2.0)
    ask(bus, "4008100000000000")
    bus.drives.tick(2.9)
    ask(bus, "6000000000000000")  # the wait begins anew
    bus.drives.tick(3.89)
    assert bus.exchange() == []
    bus.drives.tick(3.9)
    assert bus.exchange() == [(0x581, bytes.fromhex("80081000" + TIMED_OUT))]
    bus.drives.tick(9.0)
    assert bus.exchange() == []


@pytest.mark.parametrize(
    "end", [(0x601, "8008100000000008"), (0, "8201"), (0, "8101"), (0, "0201")]
)
def test_abort_reset_and_stop_end_a_transfer(bus: DriveBus, end: tuple[int, str]) -> None:
    ask(bus, "4008100000000000")
    bus.exchange((end[0], bytes.fromhex(end[1])))
    bus.drives.tick(5.0)
    assert bus.exchange() == []
    if end[1] != "0201":
        assert ask(bus, "6000000000000000")[-8:] == UNKNOWN
        assert read(bus, 1, 0x1000) == 0x0002_0192
