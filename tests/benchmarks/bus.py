"""What the user-space bus costs beyond the wire: as a ratio to raw sockets, by timing, by listener.

- *Exchange*: :mod:`tests.benchmarks.pingpong` with a bus in place of the rig's bare sockets, and
  nothing behind it: the same frames and the same wake-ups between two processes, seven nodes on
  three buses. Its floor is the bare sockets, batched alike.
- *Throughput*: two nodes talk to each other through one bus at 20,000 frames a second, while two
  others only listen, each a process of its own; once more with a third that never reads.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from dftc_rt.drives.wiring import bus_members, bus_names
from dftc_rt.dynamics.robot import load_robot
from tests.benchmarks.interleaved import ratio
from tests.benchmarks.processes import pingpong, read_json
from tests.benchmarks.result import Aim, Result, Table

FRAMES_PER_S = 20_000
STYLES = {
    "batched": "raw sockets, sendmmsg and recvmmsg",
    "plain": "raw sockets, a call a frame",
    "off": "user-space bus, timing off",
    "account": "user-space bus, timing account",
}


def run(quick: bool = False) -> Result:
    """Measure.

    Args:
        quick: One short round, to see that it works.
    """
    seconds, rounds = (1.0, 1) if quick else (3.0, 3)
    joints = load_robot("panda").joint_config
    nodes = [int(bus_members(joints, name).size) for name in bus_names(joints)]
    exchange: dict[str, list[float]] = {style: [] for style in STYLES}
    tails: dict[str, list[float]] = {style: [] for style in STYLES}
    loaded: dict[int, list[dict[str, Any]]] = {0: [], 1: []}
    said: list[str] = []
    for _ in range(rounds):
        for style in STYLES:
            found = pingpong(style, nodes, seconds)
            exchange[style].append(found["p50_us"])
            tails[style].append(found["p99_us"])
            said += found["refused"]
        for stuck, runs in loaded.items():
            runs.append(_throughput(seconds, stuck))
            said += runs[-1]["scheduling_refused"]
    batched, off = exchange["batched"], exchange["off"]
    rows = [
        (STYLES[style], float(np.median(us)), min(us), float(np.median(tails[style])),
         ratio(us, batched), ratio(us, exchange["plain"]), ratio(us, off))
        for style, us in exchange.items()
    ]  # fmt: skip
    return Result(
        "bus",
        [
            Table(
                "Exchange on a bus alone: panda's seven nodes, three buses, 1 kHz; medians, us",
                ("", "p50", "least p50", "p99", "x batched", "x plain", "x off"),
                rows,
            ),
            _throughput_table(loaded),
        ],
        [
            Aim("account over off", "<=", 1.3, ratio(exchange["account"], off)),
            Aim("off over raw sockets, batched alike", "<=", 1.5, ratio(off, batched)),
            Aim("off over raw sockets, a call a frame", "<=", 1.5, ratio(off, exchange["plain"])),
            Aim(
                "frames a second through the bus, each at both listeners", ">=",
                0.99 * FRAMES_PER_S, float(np.median([r["frames_per_s"] for r in loaded[0]])),
            ),
            Aim(
                "frames lost, both listeners and all rounds", "<=", 0.0,
                float(sum(r["lost"] for runs in loaded.values() for r in runs)),
            ),
            Aim(
                "processor time of the bus a frame, with a stuck listener over without", "<=", 1.1,
                ratio(*([r["bus_cpu_us"] for r in loaded[stuck]] for stuck in (1, 0))),
            ),
        ],
        [f"{rounds} rounds of {seconds:g} s each, in turn", *dict.fromkeys(said)],
    )  # fmt: skip


def _throughput_table(loaded: dict[int, list[dict[str, Any]]]) -> Table:
    def middle(runs: list[dict[str, Any]], key: str) -> float:
        return float(np.median([found[key] for found in runs]))

    return Table(
        f"One bus, {FRAMES_PER_S} frames a second asked for, two listeners; medians of runs",
        ("", "frames/s", "lost", "bus, us a frame", "lost by the stuck one"),
        [
            (
                "and a third that never reads" if stuck else "two listeners",
                middle(runs, "frames_per_s"),
                sum(found["lost"] for found in runs),
                middle(runs, "bus_cpu_us"),
                middle(runs, "stuck_lost"),
            )
            for stuck, runs in loaded.items()
        ],
    )


def _throughput(seconds: float, stuck: int) -> dict[str, Any]:
    command = [
        sys.executable, "-m", "tests.benchmarks.bus_load", "--seconds", str(seconds),
        "--frames-per-s", str(FRAMES_PER_S), "--stuck", str(stuck),
    ]  # fmt: skip
    return read_json(command, seconds)
