"""Faults of a bus, frame by frame, and the error counters that they move."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from dftc_rt.bus.bits import exact_bits
from dftc_rt.bus.frame import ERR_FLAG, Frames, frame_buffer, pack, unpack
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.config import faults as kinds
from dftc_rt.config.faults import BusFault
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.errors import InputError
from hil.bus.confinement import ErrorCounters
from hil.bus.impairments import (
    CONTROLLER,
    ERROR_BITS,
    RESTART_S,
    Impairments,
    check_nodes,
    of_bus,
)
from hil.bus.inprocess import InProcessPort

DATA = bytes(range(8))


class Bench:
    """A bus with faults, a controller's node and the drives' end."""

    def __init__(self, *faults: BusFault, seed: int = 1, joints: Sequence[str] = ()) -> None:
        self.events: list[tuple[float, int, str, str]] = []
        self.port = InProcessPort("can0")
        self.node = self.port.connect()
        self.impairments = Impairments(
            "can0", faults, seed, 0, lambda *event: self.events.append(event), joints=joints
        )
        self.port.impair(self.impairments)
        self.port.advance(0.0)

    def to_drives(self, count: int = 1, can_id: int = 0x201) -> list[tuple[int, bytes]]:
        self.node.send(batch([(can_id, DATA)] * count), count)
        inbox = frame_buffer(512)
        return unpacked(inbox, self.port.receive(inbox))

    def from_drives(
        self, count: int = 1, can_id: int = 0x181, drive: int = 0
    ) -> list[tuple[int, bytes]]:
        nodes = np.full(count, drive, dtype=np.int32)
        self.port.send(batch([(can_id, DATA)] * count), count, nodes)
        return self.heard()

    def heard(self) -> list[tuple[int, bytes]]:
        inbox = frame_buffer(512)
        return unpacked(inbox, self.node.receive(inbox))


def batch(frames: Sequence[tuple[int, bytes]]) -> Frames:
    rows = frame_buffer(max(len(frames), 1))
    for row, (can_id, data) in zip(rows, frames, strict=False):
        row[:] = np.frombuffer(pack(can_id, data), dtype=np.uint8)
    return rows


def unpacked(frames: Frames, count: int) -> list[tuple[int, bytes]]:
    return [unpack(frames[row]) for row in range(count)]


@pytest.mark.parametrize("drives", [True, False])
def test_lost_frames_are_as_many_as_their_probability_says(drives: bool) -> None:
    bench = Bench(kinds.FrameLossFault(bus="can0", probability=0.3))
    one = bench.from_drives if drives else bench.to_drives
    came = sum(len(one(10)) for _ in range(200))
    assert came == pytest.approx(1400, abs=4 * np.sqrt(2000 * 0.3 * 0.7))
    assert bench.port.statistics.lost == 2000 - came
    assert bench.events == []  # their senders do not know


def test_a_fault_acts_on_its_identifier_and_in_its_time() -> None:
    bench = Bench(
        kinds.FrameLossFault(bus="can0", probability=1.0, can_id=0x181, start_s=1.0, end_s=2.0)
    )
    for t, expected in ((0.5, 1), (1.0, 0), (1.999, 0), (2.0, 1)):
        bench.port.advance(t)
        assert len(bench.from_drives(can_id=0x181)) == expected
        assert len(bench.from_drives(can_id=0x281)) == 1
        assert len(bench.to_drives()) == 1


def test_corrupted_frames_are_repeated_until_they_get_through() -> None:
    bench = Bench(kinds.FrameCorruptionFault(bus="can0", probability=0.05))
    came = [frame for _ in range(400) for frame in bench.from_drives(5)]
    assert came == [(0x181, DATA)] * 2000
    errors = bench.port.statistics.errors
    assert 50 < errors < 160
    bits = exact_bits(batch([(0x181, DATA)]), 0)
    assert bench.port.statistics.exact_bits == 2000 * bits + errors * (bits + ERROR_BITS)


def test_corrupted_frames_are_lost_where_nobody_repeats_them() -> None:
    bench = Bench(kinds.FrameCorruptionFault(bus="can0", probability=0.2, retransmit=False))
    came = sum(len(bench.to_drives(5)) for _ in range(10))
    done = bench.port.statistics
    assert came == 50 - done.errors == 50 - done.lost
    assert 2 < done.errors < 20


def test_a_node_with_too_many_errors_leaves_the_bus_and_comes_back() -> None:
    bench = Bench(kinds.FrameCorruptionFault(bus="can0", probability=0.6, end_s=1.0))
    t = 0.0
    while not bench.impairments.off(3):
        assert t < 0.5
        t += 1e-3
        bench.port.advance(t)
        bench.from_drives(drive=3)
    texts = [text for _, _, _, text in bench.events]
    assert "drive 4 is error passive" in texts
    assert texts[-1] == "drive 4 is off the bus"
    bench.port.advance(1.0)  # no more corruption
    assert bench.from_drives(drive=3) == [(0x181, DATA)]  # it is back by now
    left = t
    bench = Bench(kinds.FrameCorruptionFault(bus="can0", probability=0.6))
    t = 0.0
    while not bench.impairments.off(3):
        t += 1e-3
        bench.port.advance(t)
        bench.from_drives(drive=3)
    assert t == left  # the same seed, the same frames
    bench.port.advance(t + 0.9 * RESTART_S)
    assert bench.from_drives(drive=3) == []
    bench.port.advance(t + 1.1 * RESTART_S)
    assert bench.events[-1][3] == "drive 4 is back on the bus"


@pytest.mark.parametrize("drives", [True, False])
def test_late_frames_come_when_they_are_due_and_in_order(drives: bool) -> None:
    bench = Bench(kinds.FrameDelayFault(bus="can0", delay_s=0.0025, end_s=0.0005))
    first = bench.from_drives(can_id=0x181) if drives else bench.to_drives(can_id=0x201)
    assert first == []
    came = []
    for k in range(1, 5):
        bench.port.advance(k * 1e-3)
        if drives:
            came.append(
                [can_id for can_id, _ in [*bench.heard(), *bench.from_drives(can_id=0x182)]]
            )
        else:
            came.append([can_id for can_id, _ in bench.to_drives(can_id=0x202)])
    late, prompt = (0x181, 0x182) if drives else (0x201, 0x202)
    assert came == [[prompt], [prompt], [late, prompt], [prompt]]
    assert bench.port.statistics.delayed == 1


def test_duplicated_frames_come_twice_and_cost_twice() -> None:
    bench = Bench(kinds.FrameDuplicationFault(bus="can0", probability=1.0))
    assert bench.to_drives(3) == [(0x201, DATA)] * 6
    assert bench.from_drives(2) == [(0x181, DATA)] * 4
    assert bench.port.statistics.frames == 10


def test_more_copies_than_the_rig_takes_at_once_come_the_next_time() -> None:
    bench = Bench(kinds.FrameDuplicationFault(bus="can0", probability=1.0))
    bench.node.send(batch([(0x201, DATA)] * 3), 3)
    inbox = frame_buffer(4)
    assert bench.port.receive(inbox) == 4
    assert bench.port.receive(inbox) == 2
    assert bench.port.receive(inbox) == 0


def test_a_babbling_node_is_heard_by_all_and_fills_the_bus() -> None:
    bench = Bench(kinds.BabbleFault(bus="can0", can_id=0x7, rate_hz=3000.0, data_bytes=2))
    seen: list[tuple[int, bytes]] = []
    heard: list[tuple[int, bytes]] = []
    for k in range(1, 101):
        bench.port.advance(k * 1e-3)
        seen += [frame for frame in bench.to_drives() if frame[0] == 0x7]
        heard += bench.heard()
    assert seen == heard == [(0x7, b"\xaa\xaa")] * 300
    bits = exact_bits(batch([(0x7, b"\xaa\xaa")]), 0)
    own = exact_bits(batch([(0x201, DATA)]), 0)
    assert bench.port.statistics.exact_bits == 300 * bits + 100 * own


def test_a_controller_off_the_bus_neither_sends_nor_hears() -> None:
    bench = Bench(kinds.BusOffFault(bus="can0", start_s=1.0, end_s=2.0))
    told: list[tuple[int, bytes]] = []
    for t, expected in ((0.5, 1), (1.5, 0), (2.5, 1)):
        bench.port.advance(t)
        assert len(bench.to_drives()) == expected
        heard = bench.from_drives()
        told += [frame for frame in heard if frame[0] & ERR_FLAG]
        assert len([frame for frame in heard if not frame[0] & ERR_FLAG]) == expected
    assert bench.port.statistics.lost == 2
    # Its interface says so on its own machine: CAN_ERR_BUSOFF, CAN_ERR_RESTARTED.
    assert told == [(0x2000_0040, bytes(8)), (0x2000_0100, bytes(8))]


def test_the_interface_of_the_controller_tells_its_state() -> None:
    bench = Bench(
        kinds.FrameCorruptionFault(
            bus="can0", probability=0.5, can_id=0x201, start_s=0.0, end_s=1.0
        )
    )
    bench.port.advance(0.5)
    told: list[bytes] = []
    for t in (0.5, 2.0):  # until it is passive; then its frames get through
        bench.port.advance(t)
        for _ in range(300):
            bench.to_drives()
            told += [data for can_id, data in bench.from_drives() if can_id == 0x2000_0204]
            if t < 1.0 and told:
                break
    assert [data[1] for data in told] == [0x30, 0x40]  # passive, both flags; active
    assert told[0][6] > 127
    assert told[1][6] <= 127


def test_a_drive_off_the_bus_sends_nothing_and_the_others_do() -> None:
    fault = kinds.BusOffFault(bus="can0", joint="elbow", start_s=1.0, end_s=2.0)
    bench = Bench(fault, joints=("shoulder", "elbow", "wrist"))
    for t, expected in ((0.5, 1), (1.5, 0), (2.5, 1)):
        bench.port.advance(t)
        assert bench.impairments.off(1) == (expected == 0)
        assert not bench.impairments.off(CONTROLLER)
        assert len(bench.from_drives(drive=1)) == expected
        assert len(bench.from_drives(drive=0)) == len(bench.from_drives(drive=2)) == 1
        assert len(bench.to_drives()) == 1
    assert bench.port.statistics.lost == 1


def test_a_drive_that_is_not_on_the_bus_cannot_be_taken_off_it() -> None:
    joints = load_robot("panda").joint_config
    faults: list[Any] = [kinds.BusOffFault(bus="can0", joint="panda_joint4")]  # it is on can1
    line = r"fault\[0\]\.joint: no joint 'panda_joint4' on can0 .*panda_joint1, panda_joint2, panda"
    with pytest.raises(InputError, match=line):
        check_nodes(faults, joints)
    check_nodes([kinds.BusOffFault(bus="can1", joint="panda_joint4")], joints)
    check_nodes([kinds.BusOffFault(bus="can0")], joints)


@pytest.mark.parametrize("profile", ["cia402", "mit", "moteus"])
def test_a_drive_off_the_bus_does_not_hear_either(profile: str) -> None:
    """Frame by frame: what its drive is sent, and what it sends, and when it is back."""
    fault = 'fault=[{bus="can0", kind="bus_off", joint="panda_joint2", start_s=0.05, end_s=0.06}]'
    opened = open_session(
        "panda_shoulder_loss", [f"bus.profile={profile}", "duration_s=0.15", fault]
    )
    found, outcome = run_simulation(opened, progress=False)
    assert outcome.end_state == "done"
    assert found.rig is not None
    age, t = found.cycle["age"], found.cycle["t"]
    assert not np.delete(age, 1, axis=1).any()
    gone = age[:, 1] > 0
    assert t[gone][0] == pytest.approx(0.05, abs=0.0011)
    assert t[gone][-1] == pytest.approx(0.06, abs=0.0021)
    # A drive without SYNC answers what it was sent: of the cycle in which it is back, nothing.
    assert gone.sum() == (10 if profile == "cia402" else 11)
    # The last command that it heard stays in force, and its age is told.
    ages = found.rig["cmd_age"][10:140, 1]
    assert ages.max() == pytest.approx(11, abs=1)
    assert np.delete(found.rig["cmd_age"][10:140], 1, axis=1).max() == 1


def test_other_nodes_hear_what_gets_through() -> None:
    bench = Bench(kinds.FrameLossFault(bus="can0", probability=0.5))
    listener = bench.port.connect()
    inbox = frame_buffer(64)
    for _ in range(50):
        drives = bench.to_drives(3)
        assert unpacked(inbox, listener.receive(inbox)) == drives
        assert bench.heard() == []  # never its own


def test_the_same_seed_gives_the_same_frames() -> None:
    def run(seed: int) -> list[int]:
        bench = Bench(kinds.FrameLossFault(bus="can0", probability=0.5), seed=seed)
        return [len(bench.from_drives()) for _ in range(64)]

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_error_counters() -> None:
    """ISO 11898-1: +8 as sender, +1 as receiver, -1 for what is intact."""
    node = ErrorCounters()
    for _ in range(15):
        node.failed()
    assert (node.tec, node.state) == (120, "active")
    node.failed()
    assert (node.tec, node.state) == (128, "passive")
    node.sent()
    assert node.state == "active"
    for _ in range(17):
        node.failed()
    assert (node.tec, node.state) == (263, "bus-off")
    node.restart()
    assert (node.tec, node.rec, node.state) == (0, 0, "active")
    for _ in range(200):
        node.spoilt()
    assert (node.rec, node.state) == (128, "passive")
    node.received()
    assert (node.rec, node.state) == (119, "active")


def test_a_bus_that_there_is_not() -> None:
    faults: list[Any] = [kinds.BusOffFault(bus="can3")]
    with pytest.raises(InputError, match=r"fault\[0\]\.bus: no bus 'can3'"):
        of_bus(faults, "can0", ["can0", "can1"])
    assert of_bus([kinds.BusOffFault(bus="can1")], "can0", ["can0", "can1"]) == []
    assert CONTROLLER < 0
