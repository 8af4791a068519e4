"""What drives without SYNC put on their buses: against the budget, and read with the DBC."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest

from dftc_rt.bus.bits import exact_bits
from dftc_rt.bus.fd_bits import exact_fd_bits
from dftc_rt.bus.frame import (
    EFF_FLAG,
    EFF_MASK,
    FD_FRAME_SIZE,
    Frames,
    frame_buffer,
    pack,
    pack_fd,
)
from dftc_rt.cli.bus_budget import _bus
from dftc_rt.cli.main import run as command
from dftc_rt.controller import bus_loads
from dftc_rt.drives.mit.scale import MitScale
from dftc_rt.drives.scale import RAD_PER_COUNT
from dftc_rt.drives.wiring import robot_drives
from dftc_rt.log.reader import read
from hil.bus.inprocess import InProcessPort
from tests.integration import captured
from tests.integration.captured import Captured, Frame

SCENARIO = "panda_shoulder_loss"
ALWAYS = ["duration_s=0.3", "fault[0].start_s=0.2"]
PROFILES = {
    "mit": ["bus.profile=mit"],
    "mit, long answers": ["bus.profile=mit", "bus.mit.answer_bytes=8"],
    "moteus": ["bus.profile=moteus", "robot.joints_per_bus=4"],
    "moteus, one bus": ["bus.profile=moteus", "robot.joints_per_bus=7", "executor.rate_hz=500"],
}


@pytest.fixture(scope="module", params=PROFILES)
def traffic(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Captured, list[str], Path]:
    settings = [*ALWAYS, *PROFILES[request.param]]
    log = tmp_path_factory.mktemp("traffic") / "run.mcap"
    return captured.run(SCENARIO, settings, log), settings, log


def rows(frames: list[Frame], fd: bool) -> Frames:
    """Some frames as a batch."""
    batch = frame_buffer(len(frames), FD_FRAME_SIZE if fd else 16)
    for row, (can_id, data) in enumerate(frames):
        packed = pack_fd(can_id, data) if fd else pack(can_id, data)
        batch[row] = np.frombuffer(packed, dtype=np.uint8)
    return batch


def bits(frames: list[Frame], fd: bool) -> float:
    """Time of some frames on the wire, in bits of the bit rate; data at five times that."""
    batch, total = rows(frames, fd), 0.0
    for row in range(len(frames)):
        if fd:
            slow, fast = exact_fd_bits(batch, row)
            total += slow + fast / 5
        else:
            total += exact_bits(batch, row)
    return total


def test_no_cycle_takes_more_than_the_budget(traffic: tuple[Captured, list[str], Path]) -> None:
    found, _, _ = traffic
    scenario, robot = found.opened.scenario, found.opened.robot
    fd = scenario.bus.profile == "moteus"
    for tap, load in zip(found.taps, bus_loads(scenario, robot), strict=True):
        cycles = tap.exchanges()
        assert len(cycles) > 100
        worst = load.worst_s * load.bitrate
        running = [bits(cycle, fd) for cycle in cycles]
        assert max(running) <= worst
        assert np.mean(running) > 0.75 * worst
        assert {len(cycle) for cycle in cycles} == {2 * load.joints}


def test_no_frame_is_later_than_the_budget_says(
    traffic: tuple[Captured, list[str], Path],
) -> None:
    """Each cycle over a bus of its own, which measures; set-up tells every drive twice."""
    found, _, _ = traffic
    scenario, robot = found.opened.scenario, found.opened.robot
    fd = scenario.bus.profile == "moteus"
    for tap, load in zip(found.taps, bus_loads(scenario, robot), strict=True):
        frames = _bus(load, scenario, robot)["frames"]
        bound = {
            number: us
            for frame in frames
            for number, us in zip(frame["identifiers"], frame["latencies_us"], strict=True)
        }
        port = InProcessPort("can0", data_bitrate=5_000_000 if fd else None)
        node = port.connect()
        inbox = frame_buffer(64, FD_FRAME_SIZE if fd else 16)
        for cycle in tap.exchanges():
            half = len(cycle) // 2
            node.send(rows(cycle[:half], fd), half)
            assert port.receive(inbox) == half
            port.send(rows(cycle[half:], fd), half)
            node.receive(inbox)
        measured = {int(number, 16): us for number, us in port.statistics.latency_us.items()}
        assert set(measured) == set(bound)
        for number, us in measured.items():
            assert 0.0 < us <= bound[number] + 0.05  # told to a tenth
        assert max(measured.values()) > 0.4 * max(bound.values())


def databases(found: Captured, settings: list[str], folder: Path) -> list[Any]:
    """Write the DBC files of a run's scenario; load them as a user's tool would."""
    words = [part for each in settings for part in ("--set", each)]
    assert command(["bus", "dbc", SCENARIO, "-o", str(folder / "x.dbc"), *words]) == 0
    several = len(found.taps) > 1
    return [
        cantools.database.load_file(folder / (f"x-{tap.name}.dbc" if several else "x.dbc"))
        for tap in found.taps
    ]


def test_a_dbc_decodes_every_frame_to_what_the_log_says(
    traffic: tuple[Captured, list[str], Path], tmp_path: Path
) -> None:
    found, settings, log = traffic
    said = read(log)
    assert said.rig is not None
    seen = np.zeros((len(said.cycle["t"]), len(said.joints), 2), dtype=int)
    for tap, database in zip(found.taps, databases(found, settings, tmp_path), strict=True):
        # The first barrier ends cycle 0; what a cycle computes goes out in the next.
        for k, cycle in enumerate(tap.exchanges(), start=1):
            running = said.cycle["state"][k] == said.cycle["state"][k - 1] == 3.0
            for can_id, data in cycle:
                number = can_id & EFF_MASK
                message = database.get_message_by_frame_id(number)
                assert message.is_extended_frame == bool(can_id & EFF_FLAG)
                joint, signals = told(message, data)
                i = said.joints.index(joint)
                if message.name.endswith("_command"):
                    seen[k, i, 0] += 1
                    if running:
                        sent = said.cycle["tau_cmd"][k - 1, i]
                        assert signals["torque"] == pytest.approx(sent, abs=1e-9)
                else:
                    seen[k, i, 1] += 1
                    for name, column in (("position", "q"), ("velocity", "v")):
                        logged = said.cycle[column][k, i]
                        assert signals[name] == pytest.approx(logged, abs=1e-9)
                    true = said.rig["q"][k, i]
                    assert abs(signals["position"] - true) <= resolution(found, i)
    last = min(len(tap.exchanges()) for tap in found.taps)
    assert (seen[1 : last + 1] == 1).all()


def told(message: Any, data: bytes) -> tuple[str, dict[str, Any]]:
    """Return the joint, and what a frame says of it by plain names."""
    signals = message.decode(data, decode_choices=False, allow_truncated=True)
    if message.name != "Answers":
        return message.name.rpartition("_")[0], signals
    names = message.get_signal_by_name("node").choices
    joint = str(names[signals.pop("node")])
    return joint, {name.removeprefix(f"{joint}_"): value for name, value in signals.items()}


def resolution(found: Captured, i: int) -> float:
    """Largest difference of a position read and the true one, rad."""
    scale = robot_drives(found.opened.robot, found.opened.scenario.bus)[i].scale
    count = abs(float(found.opened.parts.scales.values[RAD_PER_COUNT, i]))
    own = scale.p_max / 65535 if isinstance(scale, MitScale) else 1e-6  # of a float
    return 0.51 * count + own


def test_what_switches_mit_drives_and_what_they_add(tmp_path: Path) -> None:
    settings = ["bus.profile=mit", "bus.mit.answer_bytes=8", "robot.joints_per_bus=7",
                "executor.rate_hz=400", "bus.mit.p_max_rad=12.5", "bus.mit.t_max_nm=90",
                "bus.mit.v_max_rad_s=45"]  # fmt: skip
    words = [part for each in settings for part in ("--set", each)]
    assert command(["bus", "dbc", SCENARIO, "-o", str(tmp_path / "x.dbc"), *words]) == 0
    database = cantools.database.load_file(tmp_path / "x.dbc")
    # by hand: 8000h of ±12.5 is half a step above 0; temperature 30, error 0
    answer = database.decode_message(0, bytes.fromhex("02 8000 800 7ff 1e 00".replace(" ", "")))
    assert answer == {
        "node": "panda_joint2", "panda_joint2_position": pytest.approx(25 / 65535, abs=1e-9),
        "panda_joint2_velocity": pytest.approx(90 / 4095, abs=1e-9),
        "panda_joint2_torque": pytest.approx(0.0, abs=1e-9),
        "panda_joint2_temperature": 30, "panda_joint2_error": 0,
    }  # fmt: skip
    # ranges ±12.5, ±45, 0 to 500, 0 to 5, ±90: the middle codes, full gains, the largest torque
    sent = database.decode_message(3, bytes.fromhex("7fff 7ff fff fff fff".replace(" ", "")))
    assert sent == {
        "position": pytest.approx(-12.5 / 65535), "velocity": pytest.approx(-45 / 4095),
        "kp": pytest.approx(500.0), "kd": pytest.approx(5.0), "torque": pytest.approx(90.0),
    }  # fmt: skip


def test_what_stops_moteus_drives_and_what_asks_them(tmp_path: Path) -> None:
    words = ["--set", "bus.profile=moteus", "--set", "robot.joints_per_bus=4"]
    assert command(["bus", "dbc", SCENARIO, "-o", str(tmp_path / "x.dbc"), *words]) == 0
    database = cantools.database.load_file(tmp_path / "x-can0.dbc")
    message = database.get_message_by_name("panda_joint1_command")
    assert (message.frame_id, message.is_extended_frame, message.is_fd) == (0x8001, True, True)
    for data, frame in (("01000011001d011602110f50", "stop"), ("11001d011602110f", "question")):
        assert message.decode(bytes.fromhex(data), allow_truncated=True) == {"frame": frame}
    # by hand: -2.00 Nm, scales 0 and 127/127, 0.05 s
    torque = bytes.fromhex("01000a 02208000 052238ff 0223007f 012705 1100 1d01 1602")
    assert message.decode(torque) == {
        "frame": "torque", "torque": pytest.approx(-2.0), "kp_scale": 0,
        "kd_scale": pytest.approx(1.0), "timeout": pytest.approx(0.05),
    }  # fmt: skip
    answer = database.get_message_by_name("panda_joint4_answer")
    assert (answer.frame_id, answer.is_extended_frame) == (0x400, False)
    # 0.25 rev as a float is 0000803e; -400 · 0.00025 rev/s; 150 · 0.01 Nm; the fault code is left
    long = bytes.fromhex("21000b 2d010000803e 260270fe9600 210f21 5050")
    assert answer.decode(long) == {
        "mode": "timeout", "position": pytest.approx(np.pi / 2), "torque": pytest.approx(1.5),
        "velocity": pytest.approx(-0.1 * 2 * np.pi),
    }  # fmt: skip
