"""Time of the exchange of frames in one cycle, over that of the same frames on raw sockets.

The exchange, as ``dftc hil`` records it: SYNC on three buses, the rig's wake-up, its answers
taken in, and the commands sent; seven joints, 1 kHz, bus timing off. Everything in real
processes, on one core, at the priorities of ``dftc hil``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from dftc_rt.drives.wiring import bus_members, bus_names
from dftc_rt.dynamics.robot import load_robot
from tests.benchmarks.interleaved import ratio
from tests.benchmarks.pingpong import STYLES
from tests.benchmarks.processes import hil, pingpong, read_json
from tests.benchmarks.result import Aim, Result, Table

SCENARIO = "panda_shoulder_loss"
_SETTINGS = ("bus.timing=off", "fault=[]")
_STYLE_NAMES = {
    "batched": "raw sockets, sendmmsg and recvmmsg",
    "plain": "raw sockets, a call a frame",
}


def run(quick: bool = False) -> Result:
    """Measure.

    Args:
        quick: One short round, to see that it works.
    """
    seconds, rounds = (1.0, 1) if quick else (5.0, 3)
    joints = load_robot("panda").joint_config
    nodes = [int(bus_members(joints, name).size) for name in bus_names(joints)]
    exchange: dict[str, list[float]] = {"hil": [], **{style: [] for style in STYLES}}
    tails: dict[str, list[float]] = {name: [] for name in exchange}
    compute: list[float] = []
    service: dict[str, list[float]] = {"sync_p50_us": [], "commands_p50_us": []}
    frames: dict[str, float] = {}
    said: list[str] = []
    with tempfile.TemporaryDirectory(prefix="dftc-benchmark-") as folder:
        for _ in range(rounds):
            found = hil(SCENARIO, seconds, _SETTINGS, Path(folder))
            if found["end_state"] != "done":
                said.append(f"a run of dftc hil ended early: {found['reason']}")
            said += found["scheduling"]
            if found["missed_answers"]:
                said.append(f"answers missed in a run of dftc hil: {found['missed_answers']}")
            exchange["hil"].append(found["exchange_us"]["p50"])
            tails["hil"].append(found["exchange_us"]["p99"])
            compute.append(found["compute_us"]["p50"])
            total = sum(bus["frames"] for bus in found["buses"].values())
            frames["hil"] = total / found["cycles"]
            for style in STYLES:
                raw = pingpong(style, nodes, seconds)
                exchange[style].append(raw["p50_us"])
                tails[style].append(raw["p99_us"])
                frames[style] = raw["frames_per_cycle"]
                said += raw["refused"]
            for key, value in _rig_service(seconds).items():
                service[key].append(value)
    batched = exchange["batched"]
    rows = [
        (
            {"hil": "dftc hil", **_STYLE_NAMES}[name], float(np.median(us)), min(us),
            float(np.median(tails[name])), frames[name], ratio(us, batched),
            ratio(us, exchange["plain"]),
        )
        for name, us in exchange.items()
    ]  # fmt: skip
    parts = [
        ("rig: service of SYNC (last substep, sensors, answers)", *_two(service["sync_p50_us"])),
        ("rig: service of commands (three substeps ahead)", *_two(service["commands_p50_us"])),
        ("controller: compute, in dftc hil", *_two(compute)),
    ]
    return Result(
        "exchange",
        [
            Table(
                "Exchange: panda, three buses, 1 kHz, bus timing off; medians of runs, us",
                (
                    "", "p50", "least p50", "p99", "frames a cycle", "x batched", "x plain",
                ),
                rows,
            ),
            Table("For comparison, p50, us", ("", "median of runs", "least"), parts),
        ],
        [
            Aim(
                "exchange over a raw ping-pong of the same frames, batched alike", "<=", 1.5,
                ratio(exchange["hil"], batched),
            ),
            Aim(
                "exchange over a raw ping-pong with a call a frame", "<=", 1.5,
                ratio(exchange["hil"], exchange["plain"]),
            ),
        ],
        [
            f"{rounds} rounds of {seconds:g} s each, in turn; frames of dftc hil include set-up",
            "the rig's services were timed in one process with the controller",
            *dict.fromkeys(said),
        ],
    )  # fmt: skip


def _rig_service(seconds: float) -> dict[str, float]:
    """Time the rig's services in a process of their own."""
    command = [sys.executable, "-m", "tests.benchmarks.rig_service", SCENARIO]
    for setting in (*_SETTINGS, f"duration_s={seconds}"):
        command += ["--set", setting]
    found = read_json(command, seconds)
    return {key: float(found[key]) for key in ("sync_p50_us", "commands_p50_us")}


def _two(values: list[float]) -> tuple[float, float]:
    return float(np.median(values)), min(values)
