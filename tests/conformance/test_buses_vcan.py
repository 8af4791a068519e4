"""What is special about SocketCAN. Runs in a kernel with AF_CAN: ``tests/uml/run.sh``."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator

import numpy as np
import pytest

from dftc_rt.bus.barrier import BarrierSender
from dftc_rt.bus.frame import BARRIER_ID, EFF_FLAG, ERR_FLAG, FDF, frame_buffer, pack, pack_fd
from dftc_rt.bus.link_kind import link_kind
from dftc_rt.bus.select import choose_bus
from dftc_rt.bus.socketcan import SocketCanSocket
from dftc_rt.bus.stamped import StampedSocket
from dftc_rt.bus.wait import wait
from dftc_rt.errors import BusError, EnvironmentLacksError, InputError
from hil.bus.socketcan import SocketCanPort
from tests.conformance.bus_transports import batch, collect, collect_node, numbered

pytestmark = pytest.mark.vcan


def ip(*arguments: str) -> None:
    subprocess.run(["ip", "link", *arguments], check=True)


@pytest.fixture
def look_alike() -> Iterator[str]:
    """A CAN link that is no vcan but has a vcan's name: its frames could go elsewhere."""
    ip("add", "vcan7", "type", "vxcan", "peer", "name", "peer7")
    ip("set", "vcan7", "up")
    yield "vcan7"
    ip("del", "vcan7")


@pytest.fixture
def link() -> Iterator[str]:
    ip("add", "vcan8", "type", "vcan")
    ip("set", "vcan8", "up")
    yield "vcan8"
    if link_kind("vcan8") is not None:
        ip("del", "vcan8")


def test_the_kernel_tells_a_vcan_from_its_look_alike(look_alike: str) -> None:
    assert link_kind("vcan0") == "vcan"
    assert link_kind(look_alike) == "vxcan"
    assert link_kind("vcan99") is None


def test_the_rig_opens_nothing_but_vcan(look_alike: str) -> None:
    with pytest.raises(InputError, match="vxcan"):
        SocketCanPort("can7", look_alike)
    with pytest.raises(InputError, match="lo"):
        SocketCanPort("can0", "lo")
    with pytest.raises(BusError, match="vcan99"):
        SocketCanPort("can99", "vcan99")


def test_auto_takes_vcan_only_when_every_bus_has_one(look_alike: str) -> None:
    choice = choose_bus("auto", ["can0", "can1", "can2"])
    assert choice.kind == "vcan"
    assert choice.interfaces == {"can0": "vcan0", "can1": "vcan1", "can2": "vcan2"}
    assert choose_bus("auto", ["can0", "can99"]).kind == "unix"
    assert choose_bus("auto", ["can0", "can7"]).kind == "unix"
    with pytest.raises(InputError, match="vxcan"):
        choose_bus("vcan", ["can0", "can7"])
    with pytest.raises(EnvironmentLacksError, match="vcan99"):
        choose_bus("vcan", ["can99"])


def test_an_interface_that_goes_down_raises_on_both_ends(link: str) -> None:
    node = SocketCanSocket("can8", link)
    port = SocketCanPort("can8", link)
    ip("set", link, "down")
    with pytest.raises(BusError, match="can8"):
        node.send(batch(numbered(1)), 1)
    with pytest.raises(BusError, match="can8"):
        port.receive(frame_buffer(4))
    with pytest.raises(BusError, match="down"):
        SocketCanSocket("can8", link)
    node.close()
    port.close()


def test_an_interface_that_is_removed_raises(link: str) -> None:
    node = SocketCanSocket("can8", link)
    ip("del", link)
    with pytest.raises(BusError, match="can8"):
        node.receive(frame_buffer(4))
    with pytest.raises(BusError, match="can8"):
        node.send(batch(numbered(1)), 1)
    with pytest.raises(BusError, match="no CAN interface"):
        SocketCanSocket("can8", link)
    node.close()


def test_an_interface_that_comes_up_again_carries_frames_again(link: str) -> None:
    node, other = SocketCanSocket("can8", link), SocketCanSocket("can8", link)
    ip("set", link, "down")
    for end in (node, other):
        with pytest.raises(BusError, match="went down"):
            end.receive(frame_buffer(4))
    ip("set", link, "up")
    node.send(batch(numbered(2)), 2)
    assert collect_node(other, 2) == numbered(2)
    node.close()
    other.close()


def test_error_frames_come_to_whoever_asks_for_them() -> None:
    # vcan has no errors of its own, but loops those that somebody sends.
    told, untold = SocketCanSocket("can0", "vcan0", errors=True), SocketCanSocket("can0", "vcan0")
    picky = SocketCanSocket("can0", "vcan0", filters=[(0x181, 0x7FF)], errors=True)
    driver = SocketCanSocket("can0", "vcan0")
    errors = [(ERR_FLAG | 0x040, bytes(8)), (ERR_FLAG | 0x100, bytes(8))]
    driver.send(batch([*errors, (0x181, b"end")]), 3)
    assert collect_node(told, 3) == [*errors, (0x181, b"end")]
    assert collect_node(picky, 3) == [*errors, (0x181, b"end")]
    assert collect_node(untold, 1) == [(0x181, b"end")]
    for end in (told, untold, picky, driver):
        end.close()


@pytest.mark.parametrize("size", [16, 72])
def test_frames_that_are_listened_to_have_the_time_at_which_they_came(size: int) -> None:
    listener = StampedSocket("can0", "vcan0", fd=size == 72)
    node = SocketCanSocket("can0", "vcan0", fd=size == 72)
    before = time.time()
    out = frame_buffer(3, size)
    for row, raw in enumerate(
        (pack(0x101, b"a"), pack_fd(0x102, bytes(48)) if size == 72 else pack(0x102, b"b"),
         pack(ERR_FLAG | 0x20, bytes(8)))
    ):  # fmt: skip
        out[row, : len(raw)] = np.frombuffer(raw, dtype=np.uint8)
    assert node.send(out, 3) == 3
    inbox, stamps = frame_buffer(8, size), list[float]()
    assert wait([listener], 60.0)
    assert listener.receive_stamped(inbox, stamps) == 3
    assert before <= stamps[0] <= stamps[1] <= stamps[2] <= time.time()
    identifiers = inbox.view("<u4")[:3, 0].tolist()
    assert identifiers == [0x101, 0x102, ERR_FLAG | 0x20]
    if size == 72:
        assert (inbox[:3, 5] & FDF).tolist() == [0, FDF, 0]
    assert listener.receive_stamped(inbox, stamps) == 0
    assert stamps == []
    listener.close()
    node.close()


def test_an_interface_of_classical_frames_is_refused_for_can_fd() -> None:
    ip("add", "vcan9", "type", "vcan")
    ip("set", "vcan9", "mtu", "16", "up")
    try:
        with pytest.raises(BusError, match=r"vcan9 is set to classical frames \(mtu 16\)"):
            SocketCanSocket("can9", "vcan9", fd=True)
        SocketCanSocket("can9", "vcan9").close()
    finally:
        ip("del", "vcan9")


def test_the_kernel_filters_for_a_node() -> None:
    port = SocketCanPort("can0", "vcan0")
    picky = SocketCanSocket("can0", "vcan0", filters=[(0x180, 0xFFFF_FF80)])
    port.send(batch([(0x081, b"a"), (0x181, b"b"), (0x201, b"c"), (EFF_FLAG | 0x181, b"d")]), 4)
    port.send(batch([(0x1FF, b"e")]), 1)
    assert collect_node(picky, 2) == [(0x181, b"b"), (0x1FF, b"e")]
    picky.close()
    port.close()


def test_a_barrier_is_a_frame_with_the_reserved_identifier() -> None:
    port = SocketCanPort("can0", "vcan0")
    node, listener = SocketCanSocket("can0", "vcan0"), SocketCanSocket("can0", "vcan0")
    BarrierSender().send(node, 0x0102)
    assert collect_node(listener, 1) == [(BARRIER_ID, b"\x02\x01\0\0\0\0\0\0")]
    assert collect(port, 0) == []
    assert port.pop_barrier() == 0x0102
    for end in (node, listener, port):
        end.close()


def test_buses_are_apart() -> None:
    port = SocketCanPort("can1", "vcan1")
    node = SocketCanSocket("can0", "vcan0")
    neighbour = SocketCanSocket("can1", "vcan1")
    node.send(batch(numbered(3)), 3)
    neighbour.send(batch([(0x001, b"end")]), 1)
    assert collect(port, 1) == [(0x001, b"end")]
    for end in (node, neighbour, port):
        end.close()
