"""How full the buses of a run were: as planned, and as its frames or its rig tell."""

from __future__ import annotations

import math
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.analysis.faults import scenario_of
from dftc_rt.analysis.timing import period_s
from dftc_rt.bus.bits import exact_bits
from dftc_rt.bus.budget import bus_load
from dftc_rt.bus.fd_bits import exact_fd_bits
from dftc_rt.bus.frame import ERR_FLAG, FD_FRAME_SIZE, FDF, FRAME_SIZE, Frames
from dftc_rt.bus.frame_record import frames_of
from dftc_rt.errors import InputError
from dftc_rt.log.run import Run

F64 = NDArray[np.float64]

BIN_S: Final = 0.1  # over which load is averaged, at least
_BINS: Final = 2000  # at most


@dataclass(frozen=True)
class BusTraffic:
    """One bus of a run.

    Attributes:
        name: Logical bus name.
        joints: Joints on it.
        bitrate: Bits per second.
        planned: Share of the period that the cycle takes without stuffing; None when unknown.
        worst: The same with the most stuffing.
        mean: Share of the run in which the wire was occupied; None when nobody counted.
        t: Middle of each stretch of time, s, (m,); empty without frames in the log.
        load: Share of that stretch in which the wire was occupied, (m,).
    """

    name: str
    joints: int
    bitrate: int
    planned: float | None
    worst: float | None
    mean: float | None
    t: F64
    load: F64


def bus_traffic(
    run: Run, counted: Mapping[str, Mapping[str, Any]] | None = None
) -> list[BusTraffic]:
    """The buses of a run; empty when its log does not say how it was wired.

    Frames count with their own stuffing, and only while the run lasted: set-up is left out.

    Args:
        run: The run, with its frames where they were recorded.
        counted: What a rig counted, by bus: ``exact_bits``, ``bitrate`` and the like.

    Raises:
        LogError: The run's scenario cannot be read.
    """
    scenario = scenario_of(run)
    bus, rate = scenario.get("bus", {}), scenario.get("executor", {}).get("rate_hz")
    wired = _wired(run)
    if not wired or rate is None or "bitrate" not in bus:
        return []
    over_time = _over_time(run, bus)
    found = []
    for name, joints in wired.items():
        planned = worst = None
        try:
            plan = bus_load(
                name, joints, rate_hz=rate, bitrate=bus["bitrate"],
                data_bitrate=bus.get("data_bitrate", 5_000_000), profile=bus["profile"],
            )  # fmt: skip
            planned, worst = plan.nominal, plan.worst
        except InputError:
            pass  # a profile without a budget
        t, load = over_time.get(name, (np.empty(0), np.empty(0)))
        mean = float(load.mean()) if len(load) else _counted(run, (counted or {}).get(name))
        found.append(BusTraffic(name, joints, int(bus["bitrate"]), planned, worst, mean, t, load))
    return found


def _wired(run: Run) -> Counter[str]:
    """Bus name -> joints on it, in the order of the joints."""
    try:
        joints = tomllib.loads(run.attachments.get("robot.toml", b"").decode()).get("joint", ())
        return Counter(str(joint["bus"]) for joint in joints if joint["name"] in run.joints)
    except (ValueError, TypeError, KeyError, AttributeError):  # no file of this version
        return Counter()


def _counted(run: Run, bus: Mapping[str, Any] | None) -> float | None:
    """Load by what the rig counted, set-up included, over the time of the records."""
    seconds = len(run.cycle["t"]) * period_s(run.cycle["t"])
    if bus is None or not bus["exact_bits"] or not seconds:
        return None
    busy_s = bus["exact_bits"] / bus["bitrate"]
    if bus["data_bitrate"]:
        busy_s += bus["exact_data_bits"] / bus["data_bitrate"]
    return float(busy_s / seconds)


def _over_time(run: Run, bus: Mapping[str, Any]) -> dict[str, tuple[F64, F64]]:
    """Bus name -> times, s, and load; of the whole stretches of time between start and end."""
    if run.can is None or len(run.cycle["t"]) < 2:
        return {}
    records = run.can.records
    end_s = float(run.cycle["t"][-1])
    records = records[(records["t"] >= 0.0) & (records["id"] & ERR_FLAG == 0)]
    width = BIN_S * max(1, math.ceil(end_s / (BIN_S * _BINS)))
    edges = np.arange(int(end_s / width) + 1) * width
    if len(edges) < 2:
        return {}
    fd = bool(len(records)) and records["data"].shape[1] > 8
    frames = frames_of(records, FD_FRAME_SIZE if fd else FRAME_SIZE)
    busy = np.empty(len(records))
    bit_s = 1.0 / bus["bitrate"]
    _occupied(frames, bit_s, 1.0 / bus.get("data_bitrate", bus["bitrate"]), busy)
    found = {}
    for k, name in enumerate(run.can.buses):
        of_bus = records["bus"] == k
        total, _ = np.histogram(records["t"][of_bus], edges, weights=busy[of_bus])
        found[name] = (0.5 * (edges[1:] + edges[:-1]), total / width)
    return found


@njit(cache=True)
def _occupied(frames: Frames, bit_s: float, data_bit_s: float, out: F64) -> None:
    """Time on the wire of each frame, s, shape ``(K,)``, written in place."""
    for row in range(frames.shape[0]):
        if frames.shape[1] == FD_FRAME_SIZE and frames[row, 5] & FDF:
            slow, fast = exact_fd_bits(frames, row)
            out[row] = slow * bit_s + fast * data_bit_s
        else:
            out[row] = exact_bits(frames, row) * bit_s
