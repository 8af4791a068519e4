"""Loading a log over reading and decompressing its chunks; logging frames over sending them."""

from __future__ import annotations

import socket
import tempfile
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
from mcap.records import Chunk
from numpy.typing import NDArray

from dftc_rt.analysis import load
from dftc_rt.bus.frame import frame_buffer
from dftc_rt.bus.frame_record import record_dtype, record_words
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.bus.unix import UnixSocket
from dftc_rt.control.signals import NAMES
from dftc_rt.log.chunks import records
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.schema import CanLayout, cycle_layout, rig_layout
from dftc_rt.ring import Ring
from dftc_rt.rt.clock import RealClock
from dftc_rt.rt.frame_tap import FrameTap
from tests.benchmarks.interleaved import Samples, measure, ratio
from tests.benchmarks.result import Aim, Result, Table

JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
CAN = CanLayout(("can0", "can1", "can2"), 8)
_FRAMES_A_CYCLE = 20
_BATCH = 8
_PLAIN, _LOAD = "chunks, read and decompressed", "load"
_SEND, _TAPPED = "send", "send, logged"


def _signals(rng: np.random.Generator, cycles: int, size: int) -> NDArray[np.float64]:
    """Return slow motions with noise on them, as compressible as measured ones."""
    t = np.arange(cycles) * 1e-3
    slow = np.sin(np.outer(t, rng.uniform(0.5, 3.0, size)))
    found = np.where(rng.random(size) < 0.3, slow + 1e-3 * rng.standard_normal(slow.shape), 0.0)
    found[:, 0] = t
    return np.ascontiguousarray(found)


def write_log(path: Path, seconds: float, *, frames: bool) -> None:
    """Write a log of seven joints at 1 kHz as a recorder does, a block of 20 ms at a time."""
    rng, cycles = np.random.default_rng(1), round(1000 * seconds)
    cycle, rig = cycle_layout(JOINTS, NAMES), rig_layout(JOINTS)
    can = np.zeros(20 * _FRAMES_A_CYCLE, record_dtype(8))
    can["id"] = rng.integers(0x180, 0x208, len(can))
    can["length"] = 8
    with Recorder(path, cycle, rig, CAN if frames else None, urdf="<robot/>") as out:
        known, true = _signals(rng, cycles, cycle.size), _signals(rng, cycles, rig.size)
        for at in range(0, cycles, 20):
            out.write_cycles(known[at : at + 20])
            out.write_rig(true[at : at + 20])
            if frames:
                can["t"] = 1e-3 * at
                can["data"] = rng.integers(0, 256, can["data"].shape)
                out.write_frames(can.view(np.float64).reshape(len(can), CAN.size))
            out.flush_due(1e-3 * at)


def decompress(path: Path) -> int:
    """Read every chunk of a log and decompress it; return the bytes in them."""
    total = 0
    with path.open("rb") as stream:
        for record in records(stream):
            if isinstance(record, Chunk):
                total += len(lz4.frame.decompress(record.data))
    return total


def _loading(seconds: float, rounds: int, *, frames: bool) -> dict[str, Samples]:
    with tempfile.TemporaryDirectory(prefix="dftc-benchmark-") as folder:
        path = Path(folder) / "run.mcap"
        write_log(path, seconds, frames=frames)
        things: dict[str, Callable[[int], object]] = {
            _PLAIN: lambda calls: decompress(path),
            _LOAD: lambda calls: load(path),
        }
        return measure(things, rounds, 1)


def _logging(rounds: int, calls: int) -> dict[str, Samples]:
    """Time a batch over a socket, with and without the tap, the far end read in either case."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    near, far = (UnixSocket("can0", end) for end in ends)
    ring = Ring.create("can", 4096, record_words(8))
    (tapped,) = FrameTap(ring, RealClock(), 1e-3, 16).tapped([near])
    out, inbox = frame_buffer(_BATCH), frame_buffer(64)

    def send(node: FrameSocket) -> Callable[[int], object]:
        def run(calls: int) -> None:
            for _ in range(calls):
                node.send(out, _BATCH)
                far.receive(inbox)
                ring.advance(ring.pending)

        return run

    found = measure({_SEND: send(near), _TAPPED: send(tapped)}, rounds, calls)
    near.close()
    far.close()
    return found


def run(quick: bool = False) -> Result:
    """Measure.

    Args:
        quick: One short round, to see that it works.
    """
    seconds, rounds, calls = (1.0, 1, 20) if quick else (60.0, 7, 2000)
    rows = []
    loads: dict[bool, Samples] = {}
    for frames in (False, True):
        found = _loading(seconds, rounds, frames=frames)
        loads[frames] = found[_LOAD]
        title = f"{seconds:g} s, 7 joints" + (", frames" if frames else "")
        plain = found[_PLAIN]
        rows += [
            (f"{title}: {name}", each.median / 1e3, each.least / 1e3, ratio(each.wall, plain.wall))
            for name, each in found.items()
        ]
    taps = _logging(rounds, calls)
    sends = [
        (name, each.median, each.least, ratio(each.wall, taps[_SEND].wall))
        for name, each in taps.items()
    ]
    return Result(
        "log",
        [
            Table("Reading a log, ms", ("log", "median", "least", "over chunks"), rows),
            Table(
                f"A batch of {_BATCH} frames over AF_UNIX, us",
                ("", "median", "least", "over send"),
                sends,
            ),
        ],
        [Aim("load of 60 s of 7 joints, s", "<=", 0.5, loads[False].median * 1e-6)]
        if not quick
        else [],
        [f"{rounds} rounds, each thing in turn"],
    )
