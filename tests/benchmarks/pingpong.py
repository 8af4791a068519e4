"""The floor of the exchange: the same frames over raw sockets, nothing decoded.

``python -m tests.benchmarks.pingpong`` prints one JSON object. Two processes on the last
core at the priorities of ``dftc hil``, one AF_UNIX SOCK_SEQPACKET pair a bus. Every period
one side sends SYNC on each bus, waits for the answers of every node, and sends a command
to each. Styles: ``batched`` makes one ``sendmmsg`` or ``recvmmsg`` a bus and waits in
``ppoll``, as the program does; ``plain`` is one blocking ``socket.send`` or ``recv`` a frame. In
``off`` and ``account`` the other side is the user-space bus with that timing, and drives that
answer alike: what the bus costs by itself.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import sys
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from dftc_rt.bus.frame import frame_buffer, pack
from dftc_rt.bus.mmsg import FrameBatcher
from dftc_rt.bus.unix import UnixSocket
from dftc_rt.bus.wait import Waiter
from dftc_rt.cli.processes.roles import CONTROLLER_PRIORITY, RIG_PRIORITY
from dftc_rt.rt.clock import NS, RealClock
from dftc_rt.rt.process import RealTime, die_with_parent, last_core
from hil.bus.virtual_bus import VirtualBus, unpaced

STYLES = ("batched", "plain")
ON_A_BUS: Final = ("off", "account")
SLOW_EVERY = 10  # the drives' second PDO, torque actual, comes with every tenth SYNC
_SYNC = pack(0x080, bytes(1))
_FIRST_WARM = 200  # cycles that do not count
_SIGTERM = 15

Exchange = Callable[[bool], None]
"""One cycle's worth of frames; told whether the slow answers are due."""


def _rows(frame: Callable[[int], bytes], count: int) -> bytes:
    return b"".join(frame(node) for node in range(count))


def _answer(node: int) -> bytes:
    return pack(0x181 + node % 0x7F, bytes(8))


def _command(node: int) -> bytes:
    return pack(0x201 + node % 0x7F, bytes(4))


def batched_controller(
    sockets: Sequence[socket.socket], nodes: Sequence[int]
) -> tuple[Exchange, Exchange]:
    """Return the two halves of a cycle: SYNC and answers, commands."""
    batchers = [FrameBatcher(str(bus)) for bus in range(len(sockets))]
    fds = [s.fileno() for s in sockets]
    out, inbox = frame_buffer(max(nodes) + 1), frame_buffer(256)
    commands = frame_buffer(max(nodes))
    out[0] = np.frombuffer(_SYNC, dtype=np.uint8)
    commands[:] = np.frombuffer(_rows(_command, max(nodes)), dtype=np.uint8).reshape(-1, 16)
    waiter = Waiter(fds)
    per_bus = list(zip(batchers, fds, nodes, strict=True))
    total = sum(nodes)

    def read(slow: bool) -> None:
        for batcher, fd, _ in per_bus:
            batcher.send(fd, out, 1)
        due = 2 * total if slow else total
        while due > 0:
            if not waiter.wait(1.0):
                raise RuntimeError(f"{due} answers did not come")
            for batcher, fd, _ in per_bus:
                due -= batcher.receive(fd, inbox)

    def write(slow: bool) -> None:
        for batcher, fd, count in per_bus:
            batcher.send(fd, commands, count)

    return read, write


def batched_rig(sockets: Sequence[socket.socket], nodes: Sequence[int]) -> None:
    """Answer until the other side closes."""
    batchers = [FrameBatcher(str(bus)) for bus in range(len(sockets))]
    fds = [s.fileno() for s in sockets]
    inbox, answers = frame_buffer(256), frame_buffer(2 * max(nodes))
    answers[:] = np.frombuffer(_rows(_answer, 2 * max(nodes)), dtype=np.uint8).reshape(-1, 16)
    identifiers = inbox.view("<u4")
    waiter = Waiter(fds)
    syncs = [0] * len(fds)
    while True:
        waiter.wait(1.0)
        for bus, fd in enumerate(fds):
            if waiter.ready(bus):
                count = batchers[bus].receive(fd, inbox)  # raises once the other side has closed
                if count and identifiers[count - 1, 0] == 0x080:  # behind late commands
                    slow = syncs[bus] % SLOW_EVERY == 0
                    syncs[bus] += 1
                    batchers[bus].send(fd, answers, nodes[bus] * (1 + slow))


def bus_rig(timing: str) -> Callable[[Sequence[socket.socket], Sequence[int]], None]:
    """Return a server that answers through a user-space bus until the other side closes."""

    def serve(sockets: Sequence[socket.socket], nodes: Sequence[int]) -> None:
        ports = []
        for bus, connection in enumerate(sockets):
            ports.append(VirtualBus(f"can{bus}", timing=unpaced(timing)))
            ports[-1].attach(UnixSocket(f"can{bus}", connection))
        inbox, answers = frame_buffer(256), frame_buffer(2 * max(nodes))
        answers[:] = np.frombuffer(_rows(_answer, 2 * max(nodes)), dtype=np.uint8).reshape(-1, 16)
        senders = np.arange(2 * max(nodes), dtype=np.int32)
        identifiers = inbox.view("<u4")
        waiter = Waiter([port.fds()[0] for port in ports])
        syncs = [0] * len(ports)
        while all(port.fds() for port in ports):
            waiter.wait(1.0)
            for bus, port in enumerate(ports):
                if waiter.ready(bus):
                    count = port.receive(inbox)
                    if count and identifiers[count - 1, 0] == 0x080:  # behind late commands
                        slow = syncs[bus] % SLOW_EVERY == 0
                        syncs[bus] += 1
                        port.send(answers, nodes[bus] * (1 + slow), senders)

    return serve


def plain_controller(
    sockets: Sequence[socket.socket], nodes: Sequence[int]
) -> tuple[Exchange, Exchange]:
    """Return the two halves of a cycle: SYNC and answers, commands."""
    per_bus = list(zip(sockets, nodes, strict=True))
    commands = [_command(node) for node in range(max(nodes))]

    def read(slow: bool) -> None:
        for connection, _ in per_bus:
            connection.send(_SYNC)
        for connection, count in per_bus:
            for _ in range(count * (1 + slow)):
                connection.recv(16)

    def write(slow: bool) -> None:
        for connection, count in per_bus:
            for node in range(count):
                connection.send(commands[node])

    return read, write


def plain_rig(sockets: Sequence[socket.socket], nodes: Sequence[int]) -> None:
    """Answer until the other side closes."""
    per_bus = list(zip(sockets, nodes, strict=True))
    answers = [_answer(node) for node in range(2 * max(nodes))]
    k = 0
    while True:
        slow = k % SLOW_EVERY == 0
        k += 1
        for connection, count in per_bus:
            if not connection.recv(16):
                return
            for node in range(count * (1 + slow)):
                connection.send(answers[node])
        for connection, count in per_bus:
            for _ in range(count):
                connection.recv(16)


def measure(style: str, nodes: Sequence[int], seconds: float, rate_hz: float) -> dict[str, object]:
    """Run the floor; fork the other side.

    Args:
        style: Of ``STYLES`` or ``ON_A_BUS``.
        nodes: Nodes of each bus.
        seconds: Length of the run.
        rate_hz: Cycles per second.
    """
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in nodes]
    near, far = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    pid = os.fork()
    if pid == 0:
        for each in near:
            each.close()
        serve = {"batched": batched_rig, "plain": plain_rig}.get(style)
        _child(serve or bus_rig(style), far, nodes)
    for each in far:
        each.close()
    make = plain_controller if style == "plain" else batched_controller
    read, write = make(near, nodes)
    settings = RealTime(CONTROLLER_PRIORITY, last_core())
    taken = _cycles(read, write, int(seconds * rate_hz), round(NS / rate_hz))
    settings.release()
    for each in near:
        each.close()
    os.waitpid(pid, 0)
    p50, p99 = np.percentile(taken, [50, 99]) / 1e3
    per_cycle = sum(1 + 2 * count + count / SLOW_EVERY for count in nodes)
    return {
        "style": style, "p50_us": float(p50), "p99_us": float(p99), "cycles": len(taken),
        "frames_per_cycle": per_cycle, "refused": settings.refused,
    }  # fmt: skip


def _child(
    serve: Callable[[Sequence[socket.socket], Sequence[int]], None],
    sockets: Sequence[socket.socket],
    nodes: Sequence[int],
) -> None:
    """Serve at the rig's priority until the other side closes; never returns."""
    from dftc_rt.errors import BusError

    die_with_parent(_SIGTERM)
    try:
        RealTime(RIG_PRIORITY, last_core())
        serve(sockets, nodes)
    except (BusError, OSError):
        pass  # the other side has closed: the end of the run
    os._exit(0)


def _cycles(read: Exchange, write: Exchange, cycles: int, period: int) -> np.ndarray:
    """Return the time of each exchange, ns."""
    clock = RealClock()
    taken = np.zeros(cycles)
    tick = clock.now() + 50 * period
    for k in range(cycles):
        clock.sleep_until(tick)
        started = clock.now()
        slow = k % SLOW_EVERY == 0
        read(slow)
        write(slow)
        taken[k] = clock.now() - started
        tick += period
    return taken[min(_FIRST_WARM, cycles // 2) :]


def main() -> None:
    """Run the floor and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--style", choices=(*STYLES, *ON_A_BUS), default="batched")
    parser.add_argument("--nodes", type=int, nargs="+", default=[3, 2, 2], help="of each bus")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rate-hz", type=float, default=1000.0)
    options = parser.parse_args()
    found = measure(options.style, options.nodes, options.seconds, options.rate_hz)
    json.dump(found, sys.stdout)
    print()


if __name__ == "__main__":
    main()
