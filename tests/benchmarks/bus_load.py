"""One user-space bus under load: ``python -m tests.benchmarks.bus_load`` prints one JSON object.

Four processes and the bus: a node that sends numbered frames at a steady rate, a burst every
millisecond, a node that receives them, and listeners that do nothing else; one of those may be
stuck, which never reads. The bus is served as the rig's loop serves it, and like it has real-time
priority; so have the nodes, so that what else the machine does is not counted as theirs.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dftc_rt.bus.directory import BusDirectory
from dftc_rt.bus.frame import frame_buffer, pack
from dftc_rt.bus.unix import UnixSocket, connect
from dftc_rt.bus.wait import Waiter
from dftc_rt.cli.processes.roles import CONTROLLER_PRIORITY, RIG_PRIORITY
from dftc_rt.rt.clock import RealClock
from dftc_rt.rt.process import RealTime, die_with_parent, first_core, last_core
from hil.bus.unix import UnixPort, listen

LISTENERS = 2
_BURST_NS = 1_000_000
_SIGTERM = 15
_PATIENCE_S = 5.0
_LISTENER_PRIORITY = 70  # below bus and sender
_FIRST = pack(0x123, bytes(8))


def _forked(
    work: Callable[[], dict[str, int]], priority: int, core: int, hold: tuple[int, int]
) -> tuple[int, int]:
    """Start a process and wait until it is set up; return its id, and the pipe for its report.

    It ends when the pipe ``hold`` is closed: giving back locked memory takes some 50 ms, at the
    process's priority, and the last frames of others would wait for it.
    """
    near, far = os.pipe()
    pid = os.fork()
    if pid == 0:
        die_with_parent(_SIGTERM)
        os.close(near)
        os.close(hold[1])
        RealTime(priority, core)
        os.write(far, b"r")
        os.write(far, json.dumps(work()).encode() + b"\n")
        os.read(hold[0], 1)
        os._exit(0)
    os.close(far)
    os.read(near, 1)
    return pid, near


def send(node: UnixSocket, count: int, frames_per_s: float) -> dict[str, int]:
    """Send ``count`` numbered frames at a steady rate, in bursts; count what finds no room."""
    burst = max(round(frames_per_s * _BURST_NS / 1e9), 1)
    rows = frame_buffer(burst)
    rows[:] = np.frombuffer(_FIRST, dtype=np.uint8)
    numbers = rows.view("<u8")
    clock = RealClock()
    tick, sent, refused = clock.now(), 0, 0
    while sent < count:
        clock.sleep_until(tick)
        tick += _BURST_NS
        due = min(burst, count - sent)
        numbers[:due, 1] = np.arange(sent, sent + due)
        done = 0
        while done < due:
            taken = node.send(rows[done:], due - done)
            refused += due - done - taken
            done += taken
            if done < due:
                time.sleep(1e-4)
        sent += due
    return {"sent": sent, "refused": refused}


def receive(node: UnixSocket, count: int) -> dict[str, int]:
    """Receive until frame ``count - 1`` has come, or nothing comes any more; count the gaps.

    The rate is that of the bursts: from the first of them to the last.
    """
    rows = frame_buffer(256)
    numbers = rows.view("<u8")
    waiter = Waiter([node.fd])
    got = disorder = 0
    last = -1
    begun_ns = ended_ns = 0
    while last < count - 1 and waiter.wait(_PATIENCE_S):
        fresh = node.receive(rows)
        if fresh:
            found = np.concatenate([[last], numbers[:fresh, 1].astype(np.int64)])
            disorder += int(np.count_nonzero(np.diff(found) <= 0))
            got += fresh
            last = int(found[-1])
            ended_ns = time.monotonic_ns()
            begun_ns = begun_ns or ended_ns
    return {"got": got, "disorder": disorder, "took_ns": ended_ns - begun_ns}


def measure(count: int, frames_per_s: float, stuck: int) -> dict[str, Any]:
    """Send ``count`` frames through one bus; return what became of them.

    Args:
        count: Frames.
        frames_per_s: How fast.
        stuck: Listeners besides that never read.
    """
    with tempfile.TemporaryDirectory(prefix="dftc-benchmark-") as folder:
        claim = BusDirectory(Path(folder, "buses"))
        port = UnixPort("can0", listen(claim.path, "can0"), timing="account")
        nodes = [connect("can0", claim.path) for _ in range(2 + LISTENERS + stuck)]
        inbox = frame_buffer(512)
        while port.statistics.clients < len(nodes):
            port.receive(inbox)
        hold = os.pipe()
        readers = [
            _forked(lambda node=node: receive(node, count), _LISTENER_PRIORITY, first_core(), hold)
            for node in nodes[1 : 2 + LISTENERS]
        ]
        settings = RealTime(RIG_PRIORITY, last_core())
        sender = _forked(
            lambda: send(nodes[0], count, frames_per_s), CONTROLLER_PRIORITY, first_core(), hold
        )
        waiter = Waiter(port.fds())
        waiter.wait(_PATIENCE_S)
        used = time.process_time()
        while port.statistics.frames < count and waiter.wait(_PATIENCE_S):
            while port.receive(inbox) == len(inbox):  # a full one may not be all
                pass
        used = time.process_time() - used
        reports = []
        for _, pipe in [sender, *readers]:
            with os.fdopen(pipe) as stream:
                reports.append(json.loads(stream.readline()))
        for end in hold:
            os.close(end)
        for pid, _ in [sender, *readers]:
            os.waitpid(pid, 0)
        done = port.statistics
        settings.release()
        port.close()
        claim.release()
    took = max(each["took_ns"] for each in reports[1:]) / 1e9  # of who came last
    return {
        "scheduling_refused": settings.refused,
        "frames": done.frames,
        "frames_per_s": (count - frames_per_s * _BURST_NS / 1e9) / took,
        "refused": reports[0]["refused"],
        "lost": sum(count - each["got"] for each in reports[1:]),
        "disorder": sum(each["disorder"] for each in reports[1:]),
        "stuck_lost": done.dropped - sum(count - each["got"] for each in reports[1:]),
        "bus_cpu_us": 1e6 * used / max(done.frames, 1),
    }


def main() -> None:
    """Run the load and print what became of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--frames-per-s", type=float, default=20_000.0)
    parser.add_argument("--stuck", type=int, default=0)
    options = parser.parse_args()
    count = int(options.seconds * options.frames_per_s)
    json.dump(measure(count, options.frames_per_s, options.stuck), sys.stdout)
    print()


if __name__ == "__main__":
    main()
