"""What goes over the buses of lock-step runs: its bits against the budget, its bytes as a DBC."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from dftc_rt.bus.bits import exact_bits, nominal_bits, worst_bits
from dftc_rt.bus.budget import BusLoad
from dftc_rt.bus.frame import frame_buffer, pack
from dftc_rt.cli.main import run as command
from dftc_rt.controller import bus_loads
from dftc_rt.drives.scale import RAD_PER_COUNT, TORQUE_PER_COUNT
from dftc_rt.log.reader import read
from tests.integration import captured
from tests.integration.captured import Captured, Frame

SCENARIOS = {
    "panda_shoulder_loss": "panda_joint2",
    "ur5_elbow_loss": "elbow_joint",
    "ur10_shoulder_loss": "shoulder_lift_joint",
    "xarm7_shoulder_loss": "joint2",
}
SETTINGS = ["duration_s=0.5", "fault[0].start_s=0.3"]


@pytest.fixture(scope="module", params=SCENARIOS)
def traffic(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Captured, Path]:
    log = tmp_path_factory.mktemp("traffic") / "run.mcap"
    return captured.run(request.param, SETTINGS, log), log


def bits(frames: list[Frame]) -> int:
    """Exact bits of some frames."""
    batch = frame_buffer(len(frames))
    for row, (can_id, data) in enumerate(frames):
        batch[row] = np.frombuffer(pack(can_id, data), dtype=np.uint8)
    return sum(exact_bits(batch, row) for row in range(len(frames)))


def loads(found: Captured) -> list[BusLoad]:
    return bus_loads(found.opened.scenario, found.opened.robot)


def test_no_cycle_takes_more_bits_than_the_busiest(traffic: tuple[Captured, Path]) -> None:
    found, _ = traffic
    for tap, load in zip(found.taps, loads(found), strict=True):
        cycles = tap.cycles()
        assert len(cycles) > 500
        most = max(bits(cycle) for cycle in cycles)
        assert most <= load.busiest_bits
        # Nothing but what the budget knows, and of that no more.
        kinds = Counter[str]()
        for cycle in cycles:
            now = Counter(kind(can_id) for can_id, _ in cycle)
            kinds |= now
        assert kinds["other"] == 0
        frames = {item.name: item.most for item in load.items}
        assert kinds["SYNC"] == frames["SYNC with counter"] == 1
        assert kinds["RPDO1"] == frames["RPDO1 command"]
        assert kinds["TPDO1"] == frames["TPDO1 position, velocity"]
        assert kinds["TPDO2"] <= frames["TPDO2 statusword, mode"]
        assert kinds["TPDO3"] == frames["TPDO3 torque"]
        assert kinds["heartbeat"] <= frames["heartbeat"] + frames["controller heartbeat"]
        assert kinds["SDO"] == kinds["EMCY"] == 0  # in operation they come unasked or not at all


def test_a_long_run_takes_no_more_than_the_worst_case(traffic: tuple[Captured, Path]) -> None:
    found, _ = traffic
    for tap, load in zip(found.taps, loads(found), strict=True):
        cycles = tap.cycles()
        mean = sum(map(bits, cycles)) / len(cycles)
        cyclic = [item for item in load.items if item.role in ("sync", "command", "answer")]
        assert sum(item.nominal_bits for item in cyclic) < mean
        assert mean < sum(item.worst_bits for item in load.items)


def test_every_frame_is_as_long_as_the_bounds_allow(traffic: tuple[Captured, Path]) -> None:
    found, _ = traffic
    for tap in found.taps:
        for can_id, data in set(tap.frames):
            length = bits([(can_id, data)])
            assert nominal_bits(len(data)) <= length <= worst_bits(len(data))


def test_nothing_was_missed(traffic: tuple[Captured, Path]) -> None:
    found, _ = traffic
    for tap, counted in zip(found.taps, found.statistics, strict=True):
        # The last batch of set-up's end may wait unread at the controller.
        assert 0 <= counted.frames - len(tap.frames) <= 16
        assert bits(tap.frames) <= counted.exact_bits


def kind(can_id: int) -> str:
    """Name of an identifier in the pre-defined connection set."""
    if can_id == 0x080:
        return "SYNC"
    ranges = {0x080: "EMCY", 0x180: "TPDO1", 0x200: "RPDO1", 0x280: "TPDO2", 0x380: "TPDO3",
              0x580: "SDO", 0x600: "SDO", 0x700: "heartbeat"}  # fmt: skip
    return ranges.get(can_id & ~0x7F, "other")


def databases(found: Captured, folder: Path) -> list[Any]:
    """Write the DBC files of a run's scenario; load them as a user's tool would."""
    name = found.opened.scenario.name.replace("-", "_")
    settings = [part for each in SETTINGS for part in ("--set", each)]
    assert command(["bus", "dbc", name, "-o", str(folder / "x.dbc"), *settings]) == 0
    several = len(found.taps) > 1
    return [
        cantools.database.load_file(folder / (f"x-{tap.name}.dbc" if several else "x.dbc"))
        for tap in found.taps
    ]


def test_a_dbc_decodes_every_frame_to_what_the_log_says(
    traffic: tuple[Captured, Path], tmp_path: Path
) -> None:
    found, log = traffic
    said = read(log)
    scale = found.opened.parts.scales.values
    seen = np.zeros(said.cycle["q"].shape, dtype=int)
    for tap, database in zip(found.taps, databases(found, tmp_path), strict=True):
        for k, cycle in enumerate(tap.cycles()):
            assert cycle[0] == (0x080, bytes([k % 240 + 1]))
            for can_id, data in cycle:
                message = database.get_message_by_frame_id(can_id)
                signals = message.decode(data, decode_choices=False)
                joint, _, what = message.name.rpartition("_")
                if what not in ("TPDO1", "RPDO1", "TPDO3"):
                    continue
                i = said.joints.index(joint)
                if what == "TPDO1":
                    seen[k, i] += 1
                    count = abs(scale[RAD_PER_COUNT, i])
                    assert signals["position"] == pytest.approx(said.cycle["q"][k, i], abs=1e-9)
                    assert signals["velocity"] == pytest.approx(said.cycle["v"][k, i], abs=1e-9)
                    assert said.rig is not None
                    # The encoder rounds; the rig's record k is the same instant.
                    assert abs(signals["position"] - said.rig["q"][k, i]) <= 0.5001 * count
                elif what == "RPDO1":
                    sent = said.cycle["tau_cmd"][k, i]
                    assert signals["target_torque"] == pytest.approx(sent, abs=1e-9)
                else:
                    limit = found.opened.robot.torque_limit[i] + abs(scale[TORQUE_PER_COUNT, i])
                    assert abs(signals["torque_actual"]) <= limit
    assert (seen[: len(found.taps[0].cycles())] == 1).all()


def test_joint_states_of_the_log_are_positions_of_the_dbc(
    traffic: tuple[Captured, Path], tmp_path: Path
) -> None:
    found, log = traffic
    answers: dict[str, list[dict[str, float]]] = {}
    for tap, database in zip(found.taps, databases(found, tmp_path), strict=True):
        for cycle in tap.cycles():
            for can_id, data in cycle:
                message = database.get_message_by_frame_id(can_id)
                if message.name.endswith("_TPDO1"):
                    joint = message.name.removesuffix("_TPDO1")
                    answers.setdefault(joint, []).append(message.decode(data))
    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        states = [m[3] for m in reader.iter_decoded_messages(topics=["/joint_states"])]
    assert len(states) > 20
    rate = found.opened.scenario.executor.rate_hz
    for state in states[:-1]:
        k = round((state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec) * rate)
        for joint, q, v in zip(state.name, state.position, state.velocity, strict=True):
            assert answers[joint][k]["position"] == pytest.approx(q, abs=1e-9)
            assert answers[joint][k]["velocity"] == pytest.approx(v, abs=1e-9)
