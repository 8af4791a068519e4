"""The emulated MIT drives: modes, torque, watchdog, and when they answer."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.bus.frame import frame_buffer, pack, unpack
from dftc_rt.drives.scale import JointScale
from dftc_rt.errors import InputError
from hil.drive import slots
from hil.drive.mit import MitDrives
from hil.drive.spec import DriveSpec
from tests.unit.drives.drive_bus import DriveBus
from tests.unit.drives.mit.mit_bus import drives_of, scales

ENTER, LEAVE, ZERO = (bytes.fromhex("ffffffffffffff" + last) for last in ("fc", "fd", "fe"))
# Position, velocity and gains 0; 6 Nm: (6 + 18) · 4095 / 36 = 2730 = AAAh, which the drive
# reads as 2730 · 36 / 4095 − 18 = 6 Nm = 1365 half steps.
SIX_NM = bytes.fromhex("7fff7ff000000aaa")
ZERO_NM = bytes.fromhex("7fff7ff0000007ff")
TURN = 1 << 20  # encoder counts


def bus(n: int = 2, watchdog_s: float = 0.0, **sheet: object) -> DriveBus:
    return DriveBus(drives_of(scales(n, **sheet), watchdog_s=watchdog_s))


def receive(drives: MitDrives, *frames: tuple[int, bytes]) -> None:
    """Hand frames over without taking the answers."""
    batch = frame_buffer(len(frames))
    for row, (can_id, data) in enumerate(frames):
        batch[row] = np.frombuffer(pack(can_id, data), dtype=np.uint8)
    assert drives.receive(0, batch, 0, len(frames)) == len(frames)


def answers(drives: MitDrives) -> list[bytes]:
    """Return the data of what the drives of the first bus say now."""
    out = frame_buffer(16)
    return [unpack(out[row])[1] for row in range(drives.answer(0, out))]


def position(answer: bytes) -> int:
    return answer[1] << 8 | answer[2]


def test_out_of_motor_mode_commands_are_answered_and_no_more() -> None:
    one = bus()
    assert [data[0] for _, data in one.exchange((1, SIX_NM), (2, SIX_NM))] == [1, 2]
    assert one.drives.command.tolist() == [0, 0]
    assert one.drives.commands.tolist() == [1, 1]


def test_modes_and_torque() -> None:
    one = bus()
    assert len(one.exchange((2, ENTER))) == 1
    assert one.drives.operation_enabled.tolist() == [0, 1]
    assert one.drives.command.tolist() == [0, 0]
    one.exchange((1, SIX_NM), (2, SIX_NM))
    assert one.drives.command.tolist() == [0, 1365]
    one.exchange((2, LEAVE))
    assert one.drives.operation_enabled.tolist() == [0, 0]
    assert one.drives.command.tolist() == [0, 0]
    one.exchange((2, ENTER))
    assert one.drives.command.tolist() == [0, 0]  # the torque of before is gone


def test_torque_is_limited() -> None:
    # 10 Nm are 2275 half steps. FFFh: 18 Nm, 000h: −18 Nm.
    one = bus(1, max_torque_nm=10.0)
    one.exchange((1, ENTER))
    for torque, counts in (("fff", 2275), ("000", -2275), ("800", 1), ("7ff", -1)):
        one.exchange((1, bytes.fromhex("7fff7ff000000" + torque)))
        assert one.drives.command.tolist() == [counts]


def test_gains_act_on_the_drives_own_position_and_velocity() -> None:
    # p_des = 8A3Ch: 35388 · 25 / 65535 − 12.5 = 0.99966 rad; v_des = 0: 7FFh: −0.01099 rad/s.
    # kp = 052h: 82 · 500 / 4095 = 10.0122; kd = 333h: 819 · 5 / 4095 = 1; t = 800h: 0.0044 Nm.
    # At 0.5 rad and 2 rad/s: 10.0122 · 0.49966 + 1 · (−2.01099) + 0.0044 = 2.9962 Nm.
    one = bus(1)
    one.drives.objects[0, slots.POSITION] = round(0.5 / (2 * np.pi) * TURN)
    one.drives.objects[0, slots.VELOCITY] = round(2.0 / (2 * np.pi) * TURN)
    one.exchange((1, ENTER))
    one.exchange((1, bytes.fromhex("8a3c7ff052333800")))
    assert one.drives.command[0] * 18 / 4095 == pytest.approx(2.9962, abs=0.5 * 18 / 4095)


def test_a_command_is_answered_from_the_moment_of_the_answer() -> None:
    drives = bus(1).drives
    receive(drives, (1, ZERO_NM))
    assert (drives.synced, drives.switched) == (True, False)
    drives.objects[0, slots.POSITION] = TURN // 4  # the plant has moved on
    # (π/2 + 12.5) · 65535 / 25 = 36885.2
    assert [position(a) for a in answers(drives)] == [36885]
    assert answers(drives) == []


def test_special_frames_are_answered_likewise() -> None:
    drives = bus(1).drives
    receive(drives, (1, ENTER))
    assert (drives.synced, drives.switched) == (False, True)
    drives.objects[0, slots.POSITION] = TURN // 4
    assert [position(a) for a in answers(drives)] == [36885]
    receive(drives, (9, ENTER))  # nobody's
    assert (drives.synced, drives.switched) == (False, False)


def test_a_drive_off_the_bus_hears_nothing_and_owes_no_answer() -> None:
    drives = bus(2).drives
    receive(drives, (1, ENTER), (2, ENTER))
    drives.objects[0, slots.OFF_BUS] = slots.BUS_OFF
    receive(drives, (1, LEAVE), (2, LEAVE))
    assert [a[0] for a in answers(drives)] == [2, 2]
    assert drives.operation_enabled.tolist() == [1, 0]
    drives.objects[0, slots.OFF_BUS] = 0
    assert answers(drives) == []
    receive(drives, (1, LEAVE))
    assert [a[0] for a in answers(drives)] == [1]


def test_every_frame_has_its_answer_and_its_sender() -> None:
    drives = bus(3).drives
    receive(drives, (3, ZERO_NM), (1, ENTER), (3, ZERO_NM), (2, ZERO_NM))
    out = frame_buffer(16)
    rows = drives.answer(0, out)
    assert [unpack(out[row])[1][0] for row in range(rows)] == [1, 2, 3, 3]
    assert drives.senders[:rows].tolist() == [0, 1, 2, 2]


def test_more_answers_than_fit_come_later() -> None:
    drives = bus(3).drives
    receive(drives, (1, ZERO_NM), (2, ZERO_NM), (3, ZERO_NM))
    out = frame_buffer(2)
    assert [drives.answer(0, out), drives.answer(0, out), drives.answer(0, out)] == [2, 1, 0]


@pytest.mark.parametrize(
    ("can_id", "data"),
    [
        (3, ENTER),  # nobody has node id 3
        (1, ENTER[:7]),
        (0x8000_0001, ENTER),  # 29-bit identifier 1
        (0x4000_0001, ENTER),  # remote request
        (0, bytes([1, 0, 0, 0, 0, 0])),  # an answer
    ],
)
def test_foreign_and_short_frames_are_not_answered(can_id: int, data: bytes) -> None:
    one = bus()
    assert one.exchange((can_id, data)) == []
    assert not one.drives.operation_enabled.any()


def test_watchdog_leaves_motor_mode_and_no_sooner() -> None:
    one = bus(watchdog_s=0.010)
    one.drives.tick(1.0)
    one.exchange((1, ENTER), (2, ENTER), (1, SIX_NM), (2, SIX_NM))
    one.drives.tick(1.008)
    one.exchange((2, SIX_NM))
    one.drives.tick(1.010)
    assert one.drives.operation_enabled.tolist() == [1, 1]
    one.drives.tick(1.0101)
    assert one.drives.operation_enabled.tolist() == [0, 1]
    assert one.drives.command.tolist() == [0, 1365]
    one.exchange((1, SIX_NM))  # does not bring it back
    assert one.drives.command.tolist() == [0, 1365]
    one.drives.tick(1.0181)
    assert not one.drives.operation_enabled.any()


def test_zero_moves_the_position() -> None:
    one = bus(1)
    one.drives.objects[0, slots.POSITION] = TURN
    one.exchange((1, ZERO))
    one.drives.objects[0, slots.POSITION] += TURN // 4
    ((_, data),) = one.exchange((1, ZERO_NM))
    assert position(data) == 36885  # π/2


def test_position_stays_at_the_end_or_goes_on_from_the_other() -> None:
    # 13 rad: (13 + 12.5) · 65535 / 25 = 66845.7; less 65536: 1309.
    for wraps, expected in ((False, 65535), (True, 1309)):
        one = bus(1, wraps=wraps)
        one.drives.objects[0, slots.POSITION] = round(13 / (2 * np.pi) * TURN)
        ((_, data),) = one.exchange((1, ZERO_NM))
        assert position(data) == expected


def test_velocity_and_torque_stay_at_their_ends() -> None:
    one = bus(1)
    one.drives.objects[0, slots.VELOCITY] = -100 * TURN
    one.drives.objects[0, slots.TORQUE_ACTUAL] = 9999
    ((_, data),) = one.exchange((1, ZERO_NM))
    assert data[3:] == bytes.fromhex("000fff")  # velocity 000h, torque FFFh


def test_error_takes_it_out_of_motor_mode_and_keeps_it_out() -> None:
    one = bus(1, answer_bytes=8)
    one.exchange((1, ENTER))
    one.drives.fault(0, 3)
    assert not one.drives.operation_enabled.any()
    ((_, data),) = one.exchange((1, ENTER))
    assert data[6:] == bytes([30, 3])
    assert not one.drives.operation_enabled.any()
    one.drives.fault(0, 0)
    one.exchange((1, ENTER))
    assert one.drives.operation_enabled.all()


def test_drives_of_another_profile_are_refused() -> None:
    with pytest.raises(InputError, match="a drive without ranges"):
        MitDrives([DriveSpec(1, 0, JointScale("a", 1000, 50.0, 100.0))], 1)
