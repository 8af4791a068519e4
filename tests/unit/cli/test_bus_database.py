"""DBC of one bus: read back by cantools, values by the scale table and by hand."""

from __future__ import annotations

import struct
from typing import Any

import cantools
import numpy as np
import pytest

from dftc_rt.bus.dbc import dbc_text
from dftc_rt.cli.bus_database import bus_messages, message_names
from dftc_rt.config.robot import JointConfig
from dftc_rt.drives.scale import JointScale, ScaleTable
from dftc_rt.drives.wiring import joint_scales


def joint(name: str, node_id: int, **values: Any) -> JointConfig:
    return JointConfig(
        **{
            "name": name, "node_id": node_id, "bus": "can0", "sign": 1, "zero_offset_rad": 0.0,
            "counts_per_rev": 4000, "gear": 1.0, "rated_torque_nm": 10.0,
            "torque_limit_nm": 30.0, "velocity_limit_rad_s": 3.0, "armature": 0.1,
            "delay_cycles": 1,
        }
        | values
    )  # fmt: skip


JOINTS = (
    joint("hip.left", 5),
    joint("slide", 6, sign=-1, zero_offset_rad=0.25, gear=50.0, counts_per_rev=8192),
)


def database(joints: tuple[JointConfig, ...] = JOINTS, rate_hz: float = 1000.0) -> Any:
    scales = ScaleTable.of(joint_scales(joints, [1.0, 0.9][: len(joints)]))
    messages = bus_messages(joints, [j.name == "slide" for j in joints], scales, rate_hz)
    return cantools.database.load_string(dbc_text(messages, "a test"), "dbc")


def test_positions_velocities_and_torques_are_those_of_the_scale_table() -> None:
    found = database()
    table = ScaleTable.of(joint_scales(JOINTS, [1.0, 0.9]))
    counts = np.array([-1234567, 7654321])
    speeds = np.array([-4321, 1234])
    torques = np.array([-3000, 2999])
    for i, name in enumerate(("hip_left", "slide")):
        node = JOINTS[i].node_id
        data = struct.pack("<ii", counts[i], speeds[i])
        signals = found.decode_message(0x180 + node, data)
        assert signals["position"] == pytest.approx(table.position(counts)[i], rel=1e-14)
        assert signals["velocity"] == pytest.approx(table.velocity(speeds)[i], rel=1e-14)
        command = found.decode_message(0x200 + node, struct.pack("<Hh", 0x0F, torques[i]))
        assert command["controlword"] == "enable operation"
        assert command["target_torque"] == pytest.approx(table.torque(torques)[i], rel=1e-14)
        actual = found.decode_message(0x380 + node, struct.pack("<h", torques[i]))
        assert actual["torque_actual"] == pytest.approx(table.torque(torques)[i], rel=1e-14)
        assert found.get_message_by_frame_id(0x180 + node).name == f"{name}_TPDO1"


def test_by_hand() -> None:
    # hip.left: 4000 counts a turn, so 1000 counts are a quarter turn; rated torque 10 Nm.
    found = database()
    quarter = found.decode_message(0x185, struct.pack("<ii", 1000, -2000))
    assert quarter["position"] == pytest.approx(np.pi / 2)
    assert quarter["velocity"] == pytest.approx(-np.pi)
    assert found.decode_message(0x205, b"\x06\x00\xf4\x01") == {
        "controlword": "shutdown", "target_torque": pytest.approx(5.0),
    }  # fmt: skip
    # slide: turns against the drive, and its torque constant is 0.9 of the nominal one.
    assert found.decode_message(0x386, b"\xe8\x03")["torque_actual"] == pytest.approx(-9.0)
    assert found.decode_message(0x186, bytes(8))["position"] == pytest.approx(-0.25)


def test_units_follow_the_joint() -> None:
    found = database()

    def units(name: str) -> list[str | None]:
        return [signal.unit for signal in found.get_message_by_name(name).signals]

    assert units("hip_left_TPDO1") == ["rad", "rad/s"]
    assert units("slide_TPDO1") == ["m", "m/s"]
    assert units("hip_left_RPDO1") == [None, "Nm"]
    assert units("slide_TPDO3") == ["N"]


def test_everything_else_on_the_bus() -> None:
    found = database()
    assert found.decode_message(0x000, b"\x01\x05") == {"command": "start", "node": 5}
    assert found.decode_message(0x080, b"\xf0") == {"counter": 240}
    assert found.decode_message(0x77F, b"\x05") == {"state": "operational"}
    assert found.decode_message(0x705, b"\x7f") == {"state": "pre-operational"}
    # EMCY of CiA 301: code, register, five bytes of the maker's.
    assert found.decode_message(0x086, bytes.fromhex("50820501000000ff")) == {
        "error_code": "RPDO timeout", "error_register": 5, "manufacturer": 0xFF_0000_0001,
    }  # fmt: skip
    # Expedited upload of 6041h:00h, two bytes, value 1237h (CiA 301, SDO).
    assert found.decode_message(0x585, bytes.fromhex("4b41600037120000")) == {
        "specifier": 0x4B, "index": 0x6041, "subindex": 0, "data": 0x1237,
    }  # fmt: skip
    assert found.get_message_by_frame_id(0x605).senders == ["Controller"]
    assert found.get_message_by_frame_id(0x585).senders == ["hip_left"]


def test_a_statusword_is_told_bit_by_bit() -> None:
    # 1237h: operation enabled, voltage there, no quick stop, remote, follows the command.
    signals = database().decode_message(0x285, bytes.fromhex("37120a"))
    set_bits = {name for name, value in signals.items() if value == 1}
    assert set_bits == {
        "ready_to_switch_on", "switched_on", "operation_enabled", "voltage_enabled",
        "no_quick_stop", "remote", "follows_command",
    }  # fmt: skip
    assert signals["mode"] == "cyclic synchronous torque"


@pytest.mark.parametrize(("rate_hz", "cycle"), [(1000.0, 1), (250.0, 4), (300.0, None)])
def test_cycle_times_are_whole_milliseconds_or_left_out(rate_hz: float, cycle: int | None) -> None:
    found = database(rate_hz=rate_hz)
    assert found.get_message_by_frame_id(0x080).cycle_time == cycle
    assert found.get_message_by_frame_id(0x185).cycle_time == cycle
    slow = None if cycle is None else 10 * cycle
    assert found.get_message_by_frame_id(0x385).cycle_time == slow
    assert found.get_message_by_frame_id(0x77F).cycle_time == 50
    assert found.get_message_by_frame_id(0x285).cycle_time is None


def test_names_are_plain_and_all_different() -> None:
    joints = [joint(name, k + 1) for k, name in enumerate(["a-b", "a b", "1st", "Controller", "c"])]
    names = message_names(joints)
    assert names == ["a_b_node1", "a_b_node2", "joint_1st", "Controller_node4", "c"]


def test_long_names_survive() -> None:
    # A DBC's own names end at 32 characters; cantools keeps the rest as an attribute.
    name = "a_joint_with_a_name_that_is_longer_than_any_dbc_name"
    found = database((joint(name, 1), joint(name + "_2", 2)))
    assert found.get_message_by_frame_id(0x181).name == f"{name}_TPDO1"
    assert found.get_message_by_frame_id(0x182).name == f"{name}_2_TPDO1"


def test_a_scale_is_written_to_the_last_digit() -> None:
    scale = JointScale("hip", 524_288, 29.0, 87.0, gear=101.0)
    written = database((joint("hip", 1, counts_per_rev=524_288, gear=101.0),))
    signal = written.get_message_by_frame_id(0x181).get_signal_by_name("position")
    assert signal.conversion.scale == ScaleTable.of([scale]).values[0, 0]
