"""What ``dftc control --listen`` prints."""

from __future__ import annotations

import sys
from typing import Any, Final

import msgspec
from rich.console import Console
from rich.table import Table

from dftc_rt.bus.interface import device_of
from dftc_rt.cli.listen import Heard, HeardBus
from dftc_rt.drives.cia402 import codec, states
from dftc_rt.drives.cia402.cycle import Cia402Cycle

_NMT: Final = {0: "booting", 4: "stopped", 5: "operational", 127: "pre-operational"}
_WIDTH: Final = 100


def show(heard: Heard, *, json: bool) -> int:
    """Print what was heard and the verdict.

    Returns:
        0 when nothing stands against a start, else 1.
    """
    if json:
        sys.stdout.write(msgspec.json.encode(as_json(heard)).decode() + "\n")
        return int(bool(heard.against))
    console = Console(file=sys.stdout, width=_WIDTH if not sys.stdout.isatty() else None)
    for bus in heard.buses:
        for line in _about(bus, heard.seconds):
            print(f"{bus.name}: {line}")
        if bus.census.seen:
            console.print(_identifiers(bus, heard.seconds))
    console.print(_drives(heard))
    for line in heard.against:
        print(f"against a start: {line}")
    count = f"{sum(heard.present)} of {len(heard.drives)} drives heard"
    print(f"verdict: {count}; {'do not start' if heard.against else 'nothing conflicts'}")
    return int(bool(heard.against))


def as_json(heard: Heard) -> dict[str, Any]:
    """Return the same as one object."""
    return {
        "seconds": heard.seconds,
        "ok": not heard.against,
        "against": heard.against,
        "drives": [
            {
                "joint": drive.scale.joint,
                "node": drive.node_id,
                "bus": heard.buses[drive.bus].name,
                "heard": heard.present[k],
                "said": _said(heard, k),
            }
            for k, drive in enumerate(heard.drives)
        ],
        "buses": [_bus_json(bus, heard.seconds) for bus in heard.buses],
    }


def _bus_json(bus: HeardBus, seconds: float) -> dict[str, Any]:
    link = None
    if bus.link is not None and bus.can is not None:
        own = {"kind": bus.link.kind, "up": bus.link.up, "mtu": bus.link.mtu,
               "txqueuelen": bus.link.queue}  # fmt: skip
        link = own | msgspec.to_builtins(bus.can)
    return {
        "name": bus.name,
        "interface": device_of(bus.socket),
        "link": link,
        "lost": bus.lost,
        "frames": bus.census.frames,
        "load": bus.census.bit_s / seconds,
        "budget_nominal": bus.load.nominal,
        "budget_worst": bus.load.worst,
        "error_frames": bus.census.errors.frames,
        "errors": bus.census.errors.counts,
        "identifiers": [
            {
                "identifier": seen.name,
                "speaker": bus.roles[can_id].speaker,
                "what": bus.roles[can_id].what,
                "frames": seen.frames,
                "bytes": seen.length,
                "period_s": seen.period_s,
                "jitter_s": seen.jitter_s,
            }
            for can_id, seen in sorted(bus.census.seen.items())
        ],
    }


def _about(bus: HeardBus, seconds: float) -> list[str]:
    """Return the lines on a bus as a whole."""
    census, lines = bus.census, list[str]()
    if bus.link is not None and bus.can is not None:
        words = [bus.link.kind or "hardware", "up" if bus.link.up else "down",
                 f"mtu {bus.link.mtu}", f"txqueuelen {bus.link.queue}"]  # fmt: skip
        if bus.can.bitrate:
            words.append(f"{bus.can.bitrate} bit/s sampled at {bus.can.sample_point:.1%}")
        if bus.can.data_bitrate:
            words.append(f"data at {bus.can.data_bitrate} bit/s")
        words += [word for word in (bus.can.state, *bus.can.modes) if word]
        if bus.can.restart_ms is not None:
            ms = bus.can.restart_ms
            words.append(f"restart-ms {ms}" if ms else "restart-ms 0: stays off after bus-off")
        if bus.can.tec is not None:
            words.append(f"errors as sender {bus.can.tec}, as receiver {bus.can.rec}")
        lines.append(f"{device_of(bus.socket)}: {', '.join(words)}")
    lines.append(
        f"{census.frames / seconds:.0f} frames/s, {census.bit_s / seconds:.1%} of the wire; "
        f"we would take {bus.load.nominal:.0%}, at worst {bus.load.worst:.0%}"
    )
    if census.errors.frames:
        kinds = census.errors.summary() or "changes of state"
        lines.append(f"{census.errors.frames} error frames: {kinds}; now {census.errors.state}")
    return lines


def _identifiers(bus: HeardBus, seconds: float) -> Table:
    table = Table(show_edge=False, pad_edge=False)
    table.add_column("identifier", no_wrap=True)
    table.add_column("what")
    for name in ("frames/s", "period / ms", "jitter / ms", "bytes"):
        table.add_column(name, justify="right")
    for can_id, seen in sorted(bus.census.seen.items()):
        role = bus.roles[can_id]
        what = role.what or "unknown"
        if role.speaker == "unknown" and role.what:
            what = f"unknown ({role.what})"
        table.add_row(
            seen.name, what, f"{seen.frames / seconds:.1f}", _ms(seen.period_s),
            _ms(seen.jitter_s), str(seen.length),
        )  # fmt: skip
    return table


def _ms(seconds: float | None) -> str:
    return "" if seconds is None else f"{1e3 * seconds:.3f}"


def _drives(heard: Heard) -> Table:
    table = Table(show_edge=False, pad_edge=False)
    for name in ("joint", "node", "bus", "heard"):
        table.add_column(name)
    for k, drive in enumerate(heard.drives):
        said = _said(heard, k)
        table.add_row(
            drive.scale.joint, str(drive.node_id), heard.buses[drive.bus].name,
            said if heard.present[k] else "nothing",
        )  # fmt: skip
    return table


def _said(heard: Heard, k: int) -> str:
    """Return what a drive said, in words, by the profile's reading."""
    drive, cycle = heard.drives[k], heard.cycle
    bus = heard.buses[drive.bus]
    joint = drive.scale.joint
    words = [
        role.what.removesuffix(f" of {joint}") for role in bus.roles.values() if role.joint == joint
    ]
    seen = int(cycle.seen[k])
    if isinstance(cycle, Cia402Cycle):
        words += _said_402(cycle, k, seen)
    elif seen and not words:
        words.append("answers")
    if seen & 1:
        words.append(f"at {cycle.q[k]:.3f} rad")
    if heard.asked and not heard.asked[k]:
        words.append("is what the robot file says")
    return ", ".join(words)


def _said_402(cycle: Cia402Cycle, k: int, seen: int) -> list[str]:
    words = []
    if seen >> codec.KIND_HEARTBEAT & 1:
        nmt = int(cycle.words[codec.W_NMT, k])
        words.append(_NMT.get(nmt, f"NMT state {nmt}"))
    if seen >> codec.KIND_STATUS & 1:
        words.append(states.STATE_NAMES[states.state_of(int(cycle.status[k]))])
    if cycle.emergencies[k]:
        words.append(f"{cycle.emergencies[k]} emergencies, the last 0x{cycle.emergency[k]:04X}")
    return words
