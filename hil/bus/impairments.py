"""What faults of a bus make of its frames: lost, corrupted, late, twice, and some for nobody.

A frame passes, in this order: the sender's node is off the bus; loss; corruption, which the sender
answers with repetition; duplication; delay. Each fault draws one random number a frame from the
bus's own stream, in the order of the wire, so that a run in lock-step repeats bit for bit.

Source: docs/faults.md; retransmission as in ISO 11898-1:2015, "Recovery management".
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.bits import exact_bits
from dftc_rt.bus.error_frames import restart_frame, state_frame
from dftc_rt.bus.fd_bits import exact_fd_bits
from dftc_rt.bus.fields import can_id
from dftc_rt.bus.frame import FD_FRAME_SIZE, FDF, FRAME_SIZE, Frames, frame_buffer, pack
from dftc_rt.config import faults as kinds
from dftc_rt.config.faults import BusFault, Fault
from dftc_rt.config.robot import JointConfig
from dftc_rt.errors import InputError
from hil.bus.confinement import ErrorCounters

_STREAM: Final = 0xB05  # of the scenario's seed
ERROR_BITS: Final = 7
"""More than an intact frame takes: instead of the end of frame (7), a CRC error has a flag (6) and
a delimiter (8) behind the acknowledge delimiter."""
SUSPEND_BITS: Final = 8
"""Bits that an error passive sender waits."""
RESTART_S: Final = 0.1
"""Time that a node stays away after its counters took it off the bus, s."""
_MOST_BABBLE: Final = 256  # frames at once, when time has jumped

BABBLER: Final = -1
"""Number of the node that babbles."""
CONTROLLER: Final = -2
"""Number of the first node outside the rig; the next are lower. Their error counters are one."""

Report = Callable[[float, int, str, str], object]


@dataclass(slots=True)
class Counts:
    """What happened to frames.

    Attributes:
        lost: Frames that vanished, those of a node that is off the bus included.
        errors: Transmissions that were corrupted.
        duplicated: Frames that came twice.
        delayed: Frames that came late.
        babbled: Frames of a babbling node.
        waste: Time on the wire of transmissions that nobody took: bits at the bit rate, bits at
            the data bit rate.
    """

    lost: int = 0
    errors: int = 0
    duplicated: int = 0
    delayed: int = 0
    babbled: int = 0
    waste: tuple[int, int] = (0, 0)


def of_bus(faults: Sequence[Fault], bus: str, buses: Sequence[str]) -> list[BusFault]:
    """Return the faults of one bus.

    Args:
        faults: All faults of the scenario.
        bus: Logical bus name.
        buses: Names that the robot has.

    Raises:
        InputError: A fault names a bus that there is not.
    """
    found: list[BusFault] = []
    for k, fault in enumerate(faults):
        if not isinstance(fault, kinds.OnBus):
            continue
        if fault.bus not in buses:
            expected = "one of " + ", ".join(buses)
            raise InputError(f"fault[{k}].bus", f"no bus '{fault.bus}'", expected)
        if fault.bus == bus:
            found.append(fault)
    return found


def check_nodes(faults: Sequence[Fault], joints: Sequence[JointConfig]) -> None:
    """Check that drives which faults take off their bus are there.

    Args:
        faults: All faults of the scenario.
        joints: The robot's.

    Raises:
        InputError: A fault names a joint that has no drive on its bus.
    """
    for k, fault in enumerate(faults):
        if isinstance(fault, kinds.BusOffFault) and fault.joint is not None:
            there = [joint.name for joint in joints if joint.bus == fault.bus]
            if fault.joint not in there:
                found = f"no joint '{fault.joint}' on {fault.bus}"
                raise InputError(f"fault[{k}].joint", found, "one of " + ", ".join(there))


class Impairments:
    """The faults of one bus.

    Attributes:
        counts: What they have done so far.
        counters: Error counters of the nodes that have sent, by node.
        notices: Error frames by which the controller's interface tells of its own state, until
            somebody has passed them on; 16 bytes each.
    """

    def __init__(
        self,
        name: str,
        faults: Sequence[BusFault],
        seed: int,
        index: int,
        report: Report,
        frame_size: int = FRAME_SIZE,
        joints: Sequence[str] = (),
    ) -> None:
        """Prepare the faults of the bus ``name``.

        Args:
            name: Logical bus name.
            faults: From :func:`of_bus`.
            seed: The scenario's.
            index: Of the bus.
            report: Called as (t, severity, source, text) when a node's state changes.
            frame_size: Bytes of a row, 16, or 72 on a bus that carries FD frames.
            joints: Joint of each drive of the robot; faults of a drive's node name one.
        """
        self.counts = Counts()
        self.counters: dict[int, ErrorCounters] = {CONTROLLER: ErrorCounters()}
        self.notices: list[bytes] = []
        self._name = name
        self._held_off = False  # by a fault, not by its counters
        self._joints = tuple(joints)
        self._faults = list(faults)
        self._active: list[BusFault] = []
        self._rng = np.random.default_rng([seed, _STREAM, index])
        self._report = report
        self._t = 0.0
        self._back: dict[int, float] = {}  # when a node that is off comes back
        self._held: list[tuple[float, int, int, bytes]] = []  # due, number, sender, frame
        self._number = 0
        self._babbled = [0] * len(self._faults)
        self._out = frame_buffer(64, frame_size)
        self._nodes = np.zeros(64, dtype=np.int32)

    def advance(self, t: float) -> None:
        """Let rig time move on to ``t``, s."""
        self._t = t
        self._active = [f for f in self._faults if f.start_s <= t < f.end_s]
        for node in [node for node, until in self._back.items() if t >= until]:
            del self._back[node]
            self.counters[node].restart()
            self._report(t, 1, self._name, f"{_title(node)} is back on the bus")
            if node == CONTROLLER:
                self.notices.append(restart_frame())
        held_off = any(isinstance(f, kinds.BusOffFault) and f.joint is None for f in self._active)
        if held_off != self._held_off:
            self._held_off = held_off
            self.notices.append(state_frame("bus-off") if held_off else restart_frame())
        self._babble(t)

    def off(self, node: int) -> bool:
        """Whether a node is off the bus: it neither sends nor hears."""
        if node in self._back:
            return True
        return any(
            isinstance(fault, kinds.BusOffFault) and self._is_of(fault, node)
            for fault in self._active
        )

    def _is_of(self, fault: kinds.BusOffFault, node: int) -> bool:
        """Whether a fault takes this node off the bus."""
        if fault.joint is None:
            return node <= CONTROLLER
        return 0 <= node < len(self._joints) and self._joints[node] == fault.joint

    def waiting(self, drives: bool) -> bool:
        """Whether late frames of drives, or of the other nodes, are due by now."""
        return any(due <= self._t and (node >= 0) == drives for due, _, node, _ in self._held)

    def carry(
        self, frames: Frames, count: int, nodes: NDArray[np.int32], limit: int, drives: bool
    ) -> tuple[Frames, int, NDArray[np.int32]]:
        """Return what gets through of frames that have won the bus, and late ones before them.

        Args:
            frames: Classical batch in wire order, (capacity, 16); left as it is.
            count: Rows filled.
            nodes: Sender of each row, (>= count,).
            limit: Most frames to return; others come next time.
            drives: Whether the senders are drives; late frames of the same kind come along.

        Returns:
            Frames, how many, and their senders; valid until the next call.
        """
        out: list[tuple[bytes, int]] = self._due(drives)
        for row in range(count):
            node = int(nodes[row])
            raw = frames[row].tobytes()
            times = self._times(frames, row, node if node > CONTROLLER else CONTROLLER)
            if times and (late := self._late(can_id(frames, row))):
                for _ in range(times):
                    self._hold(self._t + late, node, raw)
                self.counts.delayed += 1
                continue
            out.extend([(raw, node)] * times)
        for raw, node in out[limit:]:
            self._hold(self._t, node, raw)
        del out[limit:]
        if len(out) > len(self._out):
            self._out = frame_buffer(2 * len(out), self._out.shape[1])
            self._nodes = np.zeros(2 * len(out), dtype=np.int32)
        for row, (raw, node) in enumerate(out):
            self._out[row] = np.frombuffer(raw, dtype=np.uint8)
            self._nodes[row] = node
        return self._out, len(out), self._nodes

    def _times(self, frames: Frames, row: int, node: int) -> int:
        """How often a frame comes: 0, 1 or 2 times."""
        number = can_id(frames, row)
        if self.off(node):
            self.counts.lost += 1
            return 0
        times = 1
        for fault in self._active:
            match fault:
                case kinds.FrameLossFault() if self._hits(fault, number) and times:
                    self.counts.lost += 1
                    self._waste(frames, row, 0)
                    times = 0
                case kinds.FrameCorruptionFault() if matches(fault, number):
                    if times and not self._gets_through(fault, frames, row, node):
                        self.counts.lost += 1
                        times = 0
                case kinds.FrameDuplicationFault() if self._hits(fault, number) and times:
                    self.counts.duplicated += 1
                    times = 2
                case _:
                    pass
        if times:
            self._intact(node)
        return times

    def _hits(
        self,
        fault: kinds.FrameLossFault | kinds.FrameDelayFault | kinds.FrameDuplicationFault,
        number: int,
    ) -> bool:
        return matches(fault, number) and bool(self._rng.random() < fault.probability)

    def _late(self, number: int) -> float:
        """By how much a frame is late, s."""
        late = 0.0
        for fault in self._active:
            if isinstance(fault, kinds.FrameDelayFault) and self._hits(fault, number):
                late += fault.delay_s
        return late

    def _gets_through(
        self, fault: kinds.FrameCorruptionFault, frames: Frames, row: int, node: int
    ) -> bool:
        """Send a frame until it is intact, the sender gives up, or is taken off the bus."""
        while self._rng.random() < fault.probability:
            sender = self.counters.setdefault(node, ErrorCounters())
            passive = sender.state == "passive"
            self.counts.errors += 1
            self._waste(frames, row, ERROR_BITS + passive * SUSPEND_BITS)
            self._spoilt(node, sender)
            if not fault.retransmit or node in self._back:
                return False
        return True

    def _waste(self, frames: Frames, row: int, more: int) -> None:
        """Count the time of a transmission that nobody takes, and ``more`` bits."""
        slow, fast = self.counts.waste
        if frames.shape[1] == FD_FRAME_SIZE and frames[row, 5] & FDF:
            own, data = exact_fd_bits(frames, row)
        else:
            own, data = exact_bits(frames, row), 0
        self.counts.waste = slow + own + more, fast + data

    def _spoilt(self, node: int, sender: ErrorCounters) -> None:
        for other, counters in self.counters.items():
            before = counters.state
            if other == node:
                sender.failed()
            else:
                counters.spoilt()
            if counters.state != before and other not in self._back:
                self._report(self._t, 2, self._name, f"{_title(other)} is {_word(counters)}")
                if other == CONTROLLER:
                    self._notify(counters)
        if sender.state == "bus-off":
            self._back[node] = self._t + RESTART_S

    def _intact(self, node: int) -> None:
        own = self.counters[CONTROLLER]
        before = own.state
        for other, counters in self.counters.items():
            if other == node:
                counters.sent()
            elif other not in self._back:
                counters.received()
        if own.state != before:
            self._notify(own)

    def _notify(self, counters: ErrorCounters) -> None:
        """Have the controller's interface tell its state."""
        self.notices.append(state_frame(counters.state, counters.tec, counters.rec))

    def _babble(self, t: float) -> None:
        for k, fault in enumerate(self._faults):
            if not isinstance(fault, kinds.BabbleFault) or not fault.start_s <= t < fault.end_s:
                continue
            due = int((t - fault.start_s) * fault.rate_hz)
            for _ in range(min(due - self._babbled[k], _MOST_BABBLE)):
                raw = pack(fault.can_id, b"\xaa" * fault.data_bytes)
                self._hold(t, BABBLER, raw.ljust(self._out.shape[1], b"\0"))
                self.counts.babbled += 1
            self._babbled[k] = due

    def _hold(self, due: float, node: int, raw: bytes) -> None:
        self._number += 1
        heapq.heappush(self._held, (due, self._number, node, raw))

    def _due(self, drives: bool) -> list[tuple[bytes, int]]:
        """Take the late frames that are due by now."""
        found: list[tuple[bytes, int]] = []
        later: list[tuple[float, int, int, bytes]] = []
        while self._held and self._held[0][0] <= self._t:
            held = heapq.heappop(self._held)
            if (held[2] >= 0) == drives:
                found.append((held[3], held[2]))
            else:
                later.append(held)
        for held in later:
            heapq.heappush(self._held, held)
        return found


def matches(
    fault: kinds.FrameLossFault
    | kinds.FrameCorruptionFault
    | kinds.FrameDelayFault
    | kinds.FrameDuplicationFault,
    number: int,
) -> bool:
    """Return whether a fault acts on frames of this identifier."""
    return fault.can_id is None or fault.can_id == number


def _title(node: int) -> str:
    return "the controller's node" if node == CONTROLLER else f"drive {node + 1}"


def _word(counters: ErrorCounters) -> str:
    return {"active": "error active", "passive": "error passive", "bus-off": "off the bus"}[
        counters.state
    ]
