"""The recorder's loop: from the rings to the log, apart from everything with a deadline."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.log.recorder import Recorder
from dftc_rt.ring import Event, EventRing, Ring

DRAIN_S: Final = 0.02
_WARNING: Final = 2
_SOURCE: Final = "recorder"
_DROPPED: Final = re.compile(r"(\d+) records of ring '(.+)' dropped: it was full")


@dataclass
class Recorded:
    """What the loop has done.

    Attributes:
        cycles: Records of ``/cycle`` logged.
        rig: Records of ``/rig`` logged.
        frames: Records of ``/can`` logged.
        events: Events logged.
        dropped: Records lost to a full ring, by the ring's name.
        finished: Whether every writer had closed and its ring was empty; False when the
            loop was told to stop first.
    """

    cycles: int
    rig: int
    frames: int
    events: int
    dropped: dict[str, int]
    finished: bool


def record(
    cycle_ring: Ring,
    rig_ring: Ring | None,
    event_rings: Sequence[EventRing],
    recorder: Recorder,
    stop: Callable[[], bool],
    *,
    frame_ring: Ring | None = None,
    wait: Callable[[float], object] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> Recorded:
    """Drain the rings into the log until the writers have closed, or ``stop`` says so.

    On ``stop`` what the rings still hold is logged before the return, so that a stop loses
    nothing that was committed. Drops appear as events. The recorder is left open.

    Args:
        cycle_ring: The controller's records.
        rig_ring: The rig's records; None when there is no rig.
        event_rings: Events of controller, rig and launcher.
        recorder: Where it goes.
        stop: Asked every pass; true to end (a signal, or the parent has gone).
        frame_ring: Every frame; None when they are not logged.
        wait: Sleeps so many seconds between passes; may return early.
        clock: Monotonic time, s.

    Raises:
        LogError: The file cannot be written.
        EnvironmentLacksError: The disk is full.
    """
    rings: dict[str, Ring | EventRing] = {"cycle": cycle_ring}
    if rig_ring is not None:
        rings["rig"] = rig_ring
    if frame_ring is not None:
        rings["can"] = frame_ring
    rings |= {f"events {i}": ring for i, ring in enumerate(event_rings)}
    done = Recorded(0, 0, 0, 0, dict.fromkeys(rings, 0), False)
    while True:
        # Asked before draining: what was committed before the end is then drained.
        done.finished = all(ring.closed for ring in rings.values())
        ending = done.finished or stop()
        done.cycles += _drain(cycle_ring, recorder.write_cycles)
        if rig_ring is not None:
            done.rig += _drain(rig_ring, recorder.write_rig)
        if frame_ring is not None:
            done.frames += drain_frames(frame_ring, recorder, ending)
        done.events += sum(_drain_events(ring, recorder) for ring in event_rings)
        _report_drops(rings, done.dropped, recorder)
        if ending:
            recorder.flush()
            return done
        recorder.flush_due(clock())
        wait(DRAIN_S)


def _drain(ring: Ring, write: Callable[[NDArray[np.float64]], None]) -> int:
    """Log what is in the ring now; no more, or a live writer could keep us here."""
    count = left = ring.pending
    while left > 0:
        block = ring.drain(left)
        write(block)
        ring.advance(len(block))
        left -= len(block)
    return count


def drain_frames(ring: Ring, recorder: Recorder, ending: bool) -> int:
    """Log the frames in the ring, once it is known when run time began.

    A run that ends before that has its last frame at 0.

    Args:
        ring: Every frame.
        recorder: Where it goes.
        ending: Whether this is the last time.

    Raises:
        LogError: The file cannot be written.
        EnvironmentLacksError: The disk is full.
    """
    origin = ring.origin
    if origin is not None:
        at = 1e-9 * origin
    elif ending and (newest := ring.latest()) is not None:
        at = float(newest[0])
    else:
        return 0
    return _drain(ring, lambda block: recorder.write_frames(block, at))


def _drain_events(ring: EventRing, recorder: Recorder) -> int:
    events = ring.drain()
    for event in events:
        recorder.write_event(*event)
    ring.advance(len(events))
    return len(events)


def _report_drops(
    rings: Mapping[str, Ring | EventRing],
    known: dict[str, int],
    recorder: Recorder,
) -> None:
    for name, ring in rings.items():
        dropped = ring.dropped
        if dropped > known[name]:
            text = f"{dropped - known[name]} records of ring {name!r} dropped: it was full"
            recorder.write_event(recorder.t, _WARNING, _SOURCE, text)
            known[name] = dropped


def dropped_records(events: Iterable[Event], ring: str) -> int:
    """Return how many records of a ring a log lacks, as its events tell.

    Args:
        events: Of the log.
        ring: Its name, ``can`` for the frames.
    """
    told = (_DROPPED.fullmatch(event.text) for event in events if event.source == _SOURCE)
    return sum(int(match[1]) for match in told if match is not None and match[2] == ring)
