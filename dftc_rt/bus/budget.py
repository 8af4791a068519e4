"""Does a cycle's traffic fit its bus? Nominal and worst-case bit time, before a run.

Per cycle a CiA 402 bus carries SYNC, for each joint a command (RPDO1: control
word and torque, 4 bytes) and an answer (TPDO1: position and velocity, 8 bytes), one
measured torque (TPDO3, 2 bytes, the joints in turn), and now and then SDO, heartbeats
and EMCY. A configuration whose worst case takes more than 90 % of the period is
refused.

What comes more rarely than every cycle counts as a share of a frame: the load is that of
a long run. In a single cycle everything may come due at once; ``busiest_bits`` is that
cycle, and :mod:`dftc_rt.bus.latency` says how long a frame then waits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from dftc_rt.bus.bits import nominal_bits, worst_bits
from dftc_rt.bus.fd_bits import nominal_fd_bits, worst_fd_bits
from dftc_rt.errors import InputError

WORST_CASE_LIMIT: Final = 0.9  # share of the period
STATUS_PER_S: Final = 100.0  # per joint, 3 bytes: TPDO2 inhibits itself for 10 ms
SDO_TRANSFERS_PER_S: Final = 100.0  # per bus; a request and a response of 8 bytes each
HEARTBEATS_PER_S: Final = 10.0  # per joint, 1 byte
MASTER_HEARTBEATS_PER_S: Final = 20.0  # the controller's, 1 byte
EMERGENCIES_PER_S: Final = 10.0  # per joint, 8 bytes
TORQUE_EVERY: Final = 10  # cycles from one TPDO3 of a drive to its next

Role = Literal["sync", "command", "answer", "status", "reserve"]


@dataclass(frozen=True, slots=True)
class LoadItem:
    """One kind of frame on a bus.

    Attributes:
        name: What it is.
        role: What it is for; ``answer`` is what the control law waits for.
        data_bytes: Data length, 0 … 8; of an FD frame one that it can have.
        per_cycle: Frames a cycle (a fraction for what comes more rarely).
        sources: What sends it independently of each other: joints, or 1. From each at most
            ``per_cycle / sources`` frames a cycle, rounded up.
        data_bit: Length of a bit of the data part of an FD frame, in bits of the bit rate;
            None: a classical frame.
        extended: 29-bit identifier; of FD frames alone.
    """

    name: str
    role: Role
    data_bytes: int
    per_cycle: float
    sources: int = 1
    data_bit: float | None = None
    extended: bool = False

    @property
    def frame_nominal_bits(self) -> float:
        """Length of one frame without stuffing, in bits of the bit rate."""
        if self.data_bit is None:
            return nominal_bits(self.data_bytes)
        slow, fast = nominal_fd_bits(self.data_bytes, self.extended)
        return slow + fast * self.data_bit

    @property
    def frame_worst_bits(self) -> float:
        """Length of one frame with the most stuffing, in bits of the bit rate."""
        if self.data_bit is None:
            return worst_bits(self.data_bytes)
        slow, fast = worst_fd_bits(self.data_bytes, self.extended)
        return slow + fast * self.data_bit

    @property
    def most(self) -> int:
        """Frames in the busiest cycle."""
        return self.sources * math.ceil(self.per_cycle / self.sources - 1e-9)

    @property
    def nominal_bits(self) -> float:
        """Bits a cycle without stuffing."""
        return self.per_cycle * self.frame_nominal_bits

    @property
    def worst_bits(self) -> float:
        """Bits a cycle with the most stuffing."""
        return self.per_cycle * self.frame_worst_bits


@dataclass(frozen=True, slots=True)
class BusLoad:
    """The traffic of one bus in one cycle.

    Attributes:
        name: Logical bus name.
        joints: Joints on the bus.
        rate_hz: Cycles per second.
        bitrate: Bits per second.
        items: What travels.
        data_bitrate: Of the data part of FD frames, where there are any.
    """

    name: str
    joints: int
    rate_hz: float
    bitrate: int
    items: tuple[LoadItem, ...]
    data_bitrate: int = 5_000_000

    @property
    def nominal_s(self) -> float:
        """Seconds of wire a cycle without stuffing."""
        return sum(item.nominal_bits for item in self.items) / self.bitrate

    @property
    def worst_s(self) -> float:
        """Seconds of wire a cycle with the most stuffing."""
        return sum(item.worst_bits for item in self.items) / self.bitrate

    @property
    def nominal(self) -> float:
        """Share of the period without stuffing."""
        return self.nominal_s * self.rate_hz

    @property
    def worst(self) -> float:
        """Share of the period with the most stuffing."""
        return self.worst_s * self.rate_hz

    @property
    def busiest_bits(self) -> int:
        """Bits of a cycle in which everything comes due, with the most stuffing."""
        return math.ceil(sum(item.most * item.frame_worst_bits for item in self.items) - 1e-9)

    @property
    def fits(self) -> bool:
        """Whether the worst case leaves a tenth of the period free."""
        return self.worst <= WORST_CASE_LIMIT


def cia402_items(joints: int, rate_hz: float, data_bit: float) -> tuple[LoadItem, ...]:
    """Return the traffic of a CiA 402 bus.

    Args:
        joints: Joints on the bus.
        rate_hz: Cycles per second.
        data_bit: Unused: the frames are classical.
    """
    turns = math.ceil(joints / TORQUE_EVERY)
    each = joints / rate_hz
    sdo = SDO_TRANSFERS_PER_S / rate_hz
    return (
        LoadItem("SYNC with counter", "sync", 1, 1.0),
        LoadItem("RPDO1 command", "command", 4, float(joints), joints),
        LoadItem("TPDO1 position, velocity", "answer", 8, float(joints), joints),
        LoadItem("TPDO3 torque", "status", 2, float(turns)),
        LoadItem("TPDO2 statusword, mode", "status", 3, each * STATUS_PER_S, joints),
        LoadItem("SDO request", "reserve", 8, sdo),
        LoadItem("SDO response", "reserve", 8, sdo),
        LoadItem("heartbeat", "reserve", 1, each * HEARTBEATS_PER_S, joints),
        LoadItem("controller heartbeat", "reserve", 1, MASTER_HEARTBEATS_PER_S / rate_hz),
        LoadItem("EMCY", "reserve", 8, each * EMERGENCIES_PER_S, joints),
    )


def mit_items(joints: int, rate_hz: float, data_bit: float) -> tuple[LoadItem, ...]:
    """Return the traffic of a bus of MIT mini-cheetah drives: one command, one answer each.

    Commands go out at the tick, in place of SYNC and in the way of the answers. What
    switches a drive goes out in place of its command. An answer is 6 bytes, or 8 with
    temperature and error: which, is the drive's affair, so it counts as 8.

    Args:
        joints: Joints on the bus.
        rate_hz: Cycles per second (every frame is cyclic, so it does not matter).
        data_bit: Unused: the frames are classical.
    """
    return (
        LoadItem("command", "sync", 8, float(joints), joints),
        LoadItem("answer", "answer", 8, float(joints), joints),
    )


def moteus_items(joints: int, rate_hz: float, data_bit: float) -> tuple[LoadItem, ...]:
    """Return the traffic of a bus of moteus drives: one command, one answer each.

    Commands go out at the tick, in place of SYNC. What stops a drive, and the answer to it
    with the fault code, are shorter together (12 and 20 bytes for 24 and 16). Commands have
    29-bit identifiers, and answers from node id 8 on, so they count as that.

    Args:
        joints: Joints on the bus.
        rate_hz: Cycles per second (every frame is cyclic, so it does not matter).
        data_bit: Length of a bit of the data part, in bits of the bit rate.
    """
    return (
        LoadItem("command", "sync", 24, float(joints), joints, data_bit, True),
        LoadItem("answer", "answer", 16, float(joints), joints, data_bit, True),
    )


_PROFILES: Final = {"cia402": cia402_items, "mit": mit_items, "moteus": moteus_items}


def bus_load(
    name: str,
    joints: int,
    *,
    rate_hz: float,
    bitrate: int = 1_000_000,
    data_bitrate: int = 5_000_000,
    profile: str = "cia402",
) -> BusLoad:
    """Return the load of one bus.

    Args:
        name: Logical bus name.
        joints: Joints on the bus.
        rate_hz: Cycles per second.
        bitrate: Bits per second.
        data_bitrate: Of the data part of FD frames.
        profile: ``cia402``, ``mit`` or ``moteus``.

    Raises:
        InputError: No budget is known for the profile, or a number is not positive.
    """
    if profile not in _PROFILES:
        raise InputError("bus.profile", repr(profile), " or ".join(_PROFILES))
    if joints < 1:
        raise InputError(name, f"{joints} joints", "at least one")
    if not rate_hz > 0.0:
        raise InputError("executor.rate_hz", repr(rate_hz), "a positive rate")
    if bitrate <= 0:
        raise InputError("bus.bitrate", repr(bitrate), "a positive bit rate")
    if data_bitrate < bitrate and profile == "moteus":
        found, expected = repr(data_bitrate), f"bus.bitrate, {bitrate}, or more"
        raise InputError("bus.data_bitrate", found, expected)
    items = _PROFILES[profile](joints, rate_hz, bitrate / data_bitrate)
    return BusLoad(name, joints, rate_hz, bitrate, items, data_bitrate)


def joints_per_bus(
    *,
    rate_hz: float,
    bitrate: int = 1_000_000,
    data_bitrate: int = 5_000_000,
    profile: str = "cia402",
) -> int:
    """Return how many joints one bus carries at most; 0 when not even one fits."""
    joints = 0
    while bus_load(
        "",
        joints + 1,
        rate_hz=rate_hz,
        bitrate=bitrate,
        data_bitrate=data_bitrate,
        profile=profile,
    ).fits:
        joints += 1
    return joints


def buses_needed(
    joints: int,
    *,
    rate_hz: float,
    bitrate: int = 1_000_000,
    data_bitrate: int = 5_000_000,
    profile: str = "cia402",
) -> int:
    """Return the least number of buses for a robot of ``joints`` joints.

    Raises:
        InputError: Not even one joint fits a bus of its own.
    """
    most = joints_per_bus(
        rate_hz=rate_hz, bitrate=bitrate, data_bitrate=data_bitrate, profile=profile
    )
    if most == 0:
        raise InputError(
            "executor.rate_hz",
            f"at {rate_hz:g} Hz and {bitrate} bit/s not even one joint fits a bus",
            "a lower rate",
        )
    return -(-joints // most)


def check(loads: Sequence[BusLoad], profile: str = "cia402") -> None:
    """Refuse a robot one of whose buses is overloaded.

    Args:
        loads: Every bus of the robot.
        profile: Profile of the loads.

    Raises:
        InputError: A bus needs over 90 % of the period in the worst case; says how many
            buses would do.
    """
    over = [load for load in loads if not load.fits]
    if not over:
        return
    worst = max(over, key=lambda load: load.worst)
    joints = sum(load.joints for load in loads)
    needed = buses_needed(
        joints,
        rate_hz=worst.rate_hz,
        bitrate=worst.bitrate,
        data_bitrate=worst.data_bitrate,
        profile=profile,
    )
    raise InputError(
        f"bus {worst.name}",
        f"{worst.joints} joints at {worst.rate_hz:g} Hz need {worst.worst:.0%} of the period"
        " in the worst case",
        f"at most {WORST_CASE_LIMIT:.0%}: {needed} buses would do for {joints} joints",
    )


def read_budget_s(load: BusLoad) -> float:
    """Return how long after the tick the answers may take, in seconds.

    The worst-case wire time of SYNC and the answers, behind one more frame of full
    length that may already occupy the wire; but no longer than leaves the commands
    their own wire time before the next tick, and the law a tenth of the period.

    Args:
        load: The bus; of several, the slowest decides.
    """
    bits = {"sync": 0.0, "command": 0.0, "answer": 0.0, "status": 0.0, "reserve": 0.0}
    for item in load.items:
        bits[item.role] += item.worst_bits
    longest = max(item.frame_worst_bits for item in load.items)
    answers = bits["sync"] + bits["answer"] + longest
    return min(
        answers / load.bitrate,
        max(1.0 / load.rate_hz - bits["command"] / load.bitrate, 0.0),  # 0: overloaded
        WORST_CASE_LIMIT / load.rate_hz,
    )
