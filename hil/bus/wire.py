"""The wire of one bus in time: one frame at a time, each for as long as its bits take.

Frames wait in one queue a node. Whenever the wire is free, the heads of the queues that are ready
by then contend, and the lowest identifier wins; what becomes ready meanwhile waits for the end. The
wire keeps no clock: it is told when a frame is ready, and says when something happens next. It is
made of kernels over arrays, because this is done for every frame.

Source: ISO 11898-1:2015, "Medium access control" (arbitration, interframe space).
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.bits import charge, exact_bits
from dftc_rt.bus.fd_bits import charge_fd, exact_fd_bits, raise_extended
from dftc_rt.bus.fields import can_id
from dftc_rt.bus.frame import FD_FRAME_SIZE, FDF, FRAME_SIZE, Frames, frame_buffer
from hil.bus.arbitration import arbitration_key

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

NEVER: Final = 1 << 62
"""A time, ns, that does not come."""
_NS: Final = 1_000_000_000
_NEVER = NEVER

# What is known of a frame that waits, one row of the table each.
_QUEUE, _SENDER, _READY, _TAKES, _KEY, _COPY = range(6)
_COLUMNS: Final = 6
# The wire itself. Of the frame on it: its row (-1: none), and when it is through.
_COUNT, _ROW, _END, _DUE, _LATE_SUM, _LATE_MAX, _THROUGH = range(7)

NOTHING: Final = 0
"""Nothing happens by then."""
BEGUN: Final = 1
"""A frame has begun."""
ENDED: Final = 2
"""The frame on the wire is at its end."""


@numba.njit("UniTuple(int64, 2)(int64[:, ::1], int64[::1])", cache=True)
def _winner(about: I64, state: I64) -> tuple[int, int]:
    """Return the row that gets the wire next, -1 when nothing waits, and when it begins, ns."""
    count = state[_COUNT]
    heads = np.empty(count, dtype=np.int64)
    known = 0
    start = _NEVER
    for row in range(count):
        behind = False
        for k in range(known):
            if about[_QUEUE, heads[k]] == about[_QUEUE, row]:
                behind = True
                break
        if not behind:
            heads[known] = row
            known += 1
            start = min(start, about[_READY, row])
    start = max(start, state[_END])
    winner = -1
    for k in range(known):
        row = heads[k]
        if about[_READY, row] <= start and (
            winner < 0 or about[_KEY, row] < about[_KEY, winner]
        ):  # fmt: skip
            winner = row
    return winner, start


@numba.njit(
    "void(uint8[:, ::1], int64, int64, int64, int64, int64,"
    " uint8[:, ::1], int64[:, ::1], int64[::1], float64, float64)",
    cache=True,
)
def _put(
    frames: Frames,
    first: int,
    count: int,
    sender: int,
    queue: int,
    ready: int,
    rows: Frames,
    about: I64,
    state: I64,
    bit_ns: float,
    data_bit_ns: float,
) -> None:
    """Append ``count`` frames of one sender, from row ``first`` on, to what waits."""
    for k in range(first, first + count):
        at = state[_COUNT]
        rows[at] = frames[k]
        about[_QUEUE, at] = queue
        about[_SENDER, at] = sender
        about[_READY, at] = ready
        about[_COPY, at] = 0
        about[_KEY, at] = arbitration_key(frames, k)
        if frames.shape[1] == FD_FRAME_SIZE and frames[k, 5] & FDF:
            slow, fast = exact_fd_bits(frames, k)
            about[_TAKES, at] = round(slow * bit_ns + fast * data_bit_ns)
        else:
            about[_TAKES, at] = round(exact_bits(frames, k) * bit_ns)
        state[_COUNT] = at + 1
    if state[_ROW] < 0:
        state[_DUE] = _winner(about, state)[1]


@numba.njit("int64(int64[:, ::1], int64[::1], int64)", cache=True)
def _begin(about: I64, state: I64, now: int) -> int:
    """Put the next winner on the wire if it begins by ``now``; return what happens by then."""
    if state[_DUE] > now:
        return NOTHING
    if state[_ROW] >= 0:
        return ENDED
    row, start = _winner(about, state)
    state[_ROW] = row
    state[_END] = state[_DUE] = start + about[_TAKES, row]
    return BEGUN


@numba.njit("void(uint8[:, ::1], int64[:, ::1], int64[::1])", cache=True)
def _leave(rows: Frames, about: I64, state: I64) -> None:
    """Take the frame off the wire and out of its queue."""
    last = state[_COUNT] - 1
    for k in range(state[_ROW], last):
        rows[k] = rows[k + 1]
        for i in range(_COLUMNS):
            about[i, k] = about[i, k + 1]
    state[_COUNT] = last
    state[_ROW] = -1
    state[_DUE] = _winner(about, state)[1]


@numba.njit(
    "void(uint8[:, ::1], uint8[:, ::1], int64[:, ::1], int64[::1], int64,"
    " int64[::1], float64, float64, float64[::1], float64[:, ::1])",
    cache=True,
)
def _through(
    out: Frames,
    rows: Frames,
    about: I64,
    state: I64,
    now: int,
    totals: I64,
    bit_s: float,
    data_bit_s: float,
    latency: F64,
    extended: F64,
) -> None:
    """Write the frame on the wire to row 0 of ``out``, and count it."""
    row = state[_ROW]
    out[0] = rows[row]
    if out.shape[1] == FD_FRAME_SIZE:
        charge_fd(out, 1, totals, bit_s, data_bit_s, latency, extended)
    else:
        charge(out, 1, totals, bit_s, latency)
    waited = 1e-9 * (state[_END] - about[_READY, row])
    if out[0, 3] & 0x80:
        raise_extended(extended, can_id(out, 0) & 0x1FFFFFFF, waited)
    else:
        number = can_id(out, 0) & 0x7FF
        latency[number] = max(latency[number], waited)
    late = now - state[_END]
    state[_THROUGH] += 1
    state[_LATE_SUM] += late
    state[_LATE_MAX] = max(state[_LATE_MAX], late)


@numba.njit(
    "int64(uint8[:, ::1], uint8[:, ::1], int64[:, ::1], int64[::1], int64,"
    " int64[::1], float64, float64, float64[::1], float64[:, ::1])",
    cache=True,
)
def _next_through(
    out: Frames,
    rows: Frames,
    about: I64,
    state: I64,
    now: int,
    totals: I64,
    bit_s: float,
    data_bit_s: float,
    latency: F64,
    extended: F64,
) -> int:
    """Let time pass up to the end of a frame, which is taken off; return its sender, or NEVER."""
    happens = BEGUN
    while happens == BEGUN:
        happens = _begin(about, state, now)
    if happens == NOTHING:
        return _NEVER
    sender = int(about[_SENDER, state[_ROW]])
    _through(out, rows, about, state, now, totals, bit_s, data_bit_s, latency, extended)
    _leave(rows, about, state)
    return sender


class Wire:
    """What waits for a bus, and the one frame on it.

    Without faults :meth:`next_through` is all there is to do. With them, each transmission is
    decided on: :meth:`begin`, :meth:`occupy`, and at its end :meth:`through`, :meth:`leave` or
    :meth:`repeat`.
    """

    def __init__(
        self,
        totals: I64,
        latency: F64,
        extended: F64,
        bitrate: int,
        data_bitrate: int | None = None,
        frame_size: int = FRAME_SIZE,
    ) -> None:
        """Begin with a free wire and empty queues.

        Args:
            totals: Frames and bits of what has come through, as ``charge`` counts them.
            latency: Longest time from readiness to the end, s, by 11-bit identifier.
            extended: The same of 29-bit identifiers, as in :func:`dftc_rt.bus.fd_bits.charge_fd`.
            bitrate: Bits per second.
            data_bitrate: Of the data part of FD frames; None: a classical bus.
            frame_size: Bytes of a row, 16 or 72.
        """
        self._totals, self._latency, self._extended = totals, latency, extended
        self._bit_s, self._data_bit_s = 1.0 / bitrate, 1.0 / (data_bitrate or bitrate)
        self._rows = frame_buffer(64, frame_size)
        self._about = np.zeros((_COLUMNS, 64), dtype=np.int64)
        self._state = np.zeros(7, dtype=np.int64)
        self._state[_ROW] = -1
        self._state[_DUE] = NEVER

    def count_into(self, totals: I64) -> None:
        """Count frames and bits there from now on, shape ``(7,)``."""
        self._totals = totals

    @property
    def due(self) -> int:
        """When something happens next, ns: the end of the frame on the wire, or a beginning."""
        return int(self._state[_DUE])

    @property
    def end(self) -> int:
        """When the wire is, or was, free again, ns."""
        return int(self._state[_END])

    @property
    def late_us(self) -> tuple[float, float]:
        """By how much frames were taken later than they were through, µs: mean, longest."""
        total, longest = int(self._state[_LATE_SUM]), int(self._state[_LATE_MAX])
        return total / max(int(self._state[_THROUGH]), 1) / 1e3, longest / 1e3

    def put(
        self,
        frames: Frames,
        first: int,
        count: int,
        sender: int,
        ready: int,
        queue: int | None = None,
    ) -> None:
        """Let frames of one node wait for the wire, behind the others of their queue.

        Args:
            frames: Batch; left as it is.
            first: First row.
            count: How many.
            sender: Node that sends them.
            ready: When they are handed over, ns.
            queue: Queue that they wait in; the sender's own by default.
        """
        while self._state[_COUNT] + count > len(self._rows):
            rows, about = self._rows, self._about
            self._rows = frame_buffer(2 * len(rows), rows.shape[1])
            self._about = np.zeros((_COLUMNS, 2 * len(rows)), dtype=np.int64)
            self._rows[: len(rows)], self._about[:, : len(rows)] = rows, about
        _put(
            frames, first, count, sender, sender if queue is None else queue, ready,
            self._rows, self._about, self._state, _NS * self._bit_s, _NS * self._data_bit_s,
        )  # fmt: skip

    def next_through(self, out: Frames, now: int) -> int:
        """Take the next frame that is through by ``now``, without faults; return its sender.

        Args:
            out: The frame, row 0.
            now: Time, ns.

        Returns:
            Sender, or :data:`NEVER` when nothing more is through.
        """
        sender: int = _next_through(
            out, self._rows, self._about, self._state, now,
            self._totals, self._bit_s, self._data_bit_s, self._latency, self._extended,
        )  # fmt: skip
        return sender

    def begin(self, now: int) -> int:
        """Let time pass up to ``now``; return NOTHING, BEGUN or ENDED, whichever comes first."""
        happens: int = _begin(self._about, self._state, now)
        return happens

    @property
    def on_wire(self) -> tuple[Frames, int, int, bool]:
        """The frame on the wire: batch and row, sender, and whether it has come through before."""
        row = int(self._state[_ROW])
        about = self._about[:, row]
        return self._rows, row, int(about[_SENDER]), bool(about[_COPY])

    def occupy(self, bits: tuple[int, int]) -> None:
        """Let the frame that has begun take other bits than its own.

        Args:
            bits: At the bit rate and at the data bit rate.
        """
        own = self._about[_TAKES, self._state[_ROW]]
        takes = round(_NS * (bits[0] * self._bit_s + bits[1] * self._data_bit_s))
        self._state[_END] += takes - own
        self._state[_DUE] = self._state[_END]

    def cancel(self) -> None:
        """Take away the frame that has begun, as if it had not."""
        self._state[_END] -= self._about[_TAKES, self._state[_ROW]]

    def through(self, out: Frames, now: int) -> None:
        """Write the frame on the wire to row 0 of ``out``, and count it."""
        _through(
            out, self._rows, self._about, self._state, now,
            self._totals, self._bit_s, self._data_bit_s, self._latency, self._extended,
        )  # fmt: skip

    def leave(self) -> int:
        """Take the frame off the wire and out of its queue; return which queue that was."""
        queue = int(self._about[_QUEUE, self._state[_ROW]])
        _leave(self._rows, self._about, self._state)
        return queue

    def repeat(self, copy: bool) -> None:
        """Take the frame off the wire; it stays the head of its queue and contends again.

        Args:
            copy: It came through, and comes a second time.
        """
        if copy:
            self._about[_COPY, self._state[_ROW]] = 1
        self._state[_ROW] = -1
        self._state[_DUE] = _winner(self._about, self._state)[1]
