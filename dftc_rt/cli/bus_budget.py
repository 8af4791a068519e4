"""``dftc bus budget``: load and latency of a robot's buses, before a run."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.table import Column, Table

from dftc_rt.bus import budget as bits
from dftc_rt.bus.frame import EFF_MASK
from dftc_rt.bus.latency import Latency, cia402_streams, latencies
from dftc_rt.bus.polled_latency import mit_frames, moteus_frames, polled_latencies
from dftc_rt.cli.bus_robot import scenario_and_robot
from dftc_rt.config.scenario import Scenario
from dftc_rt.controller import bus_loads, read_budget_s
from dftc_rt.drives.wiring import bus_members
from dftc_rt.dynamics.robot import Robot
from dftc_rt.errors import InputError


def budget(
    scenario: str | Path,
    *,
    set_: Sequence[str] = (),
    json: bool = False,
) -> int:
    """Say how loaded each bus is, and how long its frames take at most.

    Load is what a long run needs; latency is from the tick for SYNC and the answers to it,
    and from the hand-over for all else: once in operation, and once with an emergency
    (EMCY) of every drive at the same time, where the profile has such. Without SYNC (mit,
    moteus) all latencies are from the tick. Over 90 % of the period in the worst case is
    refused, with the number of buses that would do; exit code 2 then.

    Example::

        dftc bus budget panda_shoulder_loss --set executor.rate_hz=500

    Args:
        scenario: Scenario file, or the name of a shipped one.
        set_: Override a key, ``a.b=value``; may be repeated.
        json: Print one JSON object on stdout.

    Returns:
        Exit code 0.

    Raises:
        InputError: The scenario is wrong, or a bus is overloaded.
    """
    loaded, robot = scenario_and_robot(scenario, set_)
    loads = bus_loads(loaded, robot)
    found = {
        "robot": robot.name,
        "profile": loaded.bus.profile,
        "rate_hz": loaded.executor.rate_hz,
        "bitrate": loaded.bus.bitrate,
        "limit": bits.WORST_CASE_LIMIT,
        "fits": all(load.fits for load in loads),
        "buses_needed": _needed(loaded, robot),
        "read_budget_us": 1e6 * read_budget_s(loaded, loads),
        "buses": [_bus(load, loaded, robot) for load in loads],
    }
    if json:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        _show(found, Console(file=sys.stdout))
    sys.stdout.flush()  # before the line on stderr
    bits.check(loads, loaded.bus.profile)
    return 0


def _needed(scenario: Scenario, robot: Robot) -> int | None:
    """The least number of buses; None when not even one joint fits a bus."""
    try:
        return bits.buses_needed(
            robot.n,
            rate_hz=scenario.executor.rate_hz,
            bitrate=scenario.bus.bitrate,
            data_bitrate=scenario.bus.data_bitrate,
            profile=scenario.bus.profile,
        )
    except InputError:
        return None


def _bus(load: bits.BusLoad, scenario: Scenario, robot: Robot) -> dict[str, Any]:
    """One bus: its load, and its frames by kind."""
    members = bus_members(robot.joint_config, load.name)
    node_ids = [robot.joint_config[i].node_id for i in members]
    per_bit = 1e6 / load.bitrate

    def longest(emergencies: bool) -> list[Latency]:
        if scenario.bus.profile == "cia402":
            streams = cia402_streams(
                node_ids, rate_hz=load.rate_hz, bitrate=load.bitrate, emergencies=emergencies
            )
            return latencies(streams, load.bitrate)
        return [] if emergencies else _polled(load, scenario, node_ids)

    def microseconds(found: list[Latency], name: str) -> dict[int, float | None]:
        by_identifier: dict[int, float | None] = {}
        for each in found:
            if each.stream.name == name:
                us = None if each.bits is None else float(each.bits) * per_bit
                before = by_identifier.get(each.stream.can_id & EFF_MASK, 0.0)
                largest = None if us is None or before is None else max(us, before)
                by_identifier[each.stream.can_id & EFF_MASK] = largest
        return by_identifier

    operation, emergency = longest(False), longest(True)
    frames = []
    for item in load.items:
        quiet, busy = microseconds(operation, item.name), microseconds(emergency, item.name)
        frames.append(
            {
                "name": item.name,
                "role": item.role,
                "identifiers": list(busy or quiet),
                "bytes": item.data_bytes,
                "per_cycle": item.per_cycle,
                "nominal_bits": item.nominal_bits,
                "worst_bits": item.worst_bits,
                "latency_us": _largest(quiet),
                "latency_emcy_us": _largest(busy),
                "latencies_us": list(quiet.values()),
                "latencies_emcy_us": list(busy.values()),
            }
        )
    return {
        "name": load.name,
        "joints": [robot.joints[i] for i in members],
        "nominal": load.nominal,
        "worst": load.worst,
        "period_bits": load.bitrate / load.rate_hz,
        "nominal_bits": sum(item.nominal_bits for item in load.items),
        "worst_bits": sum(item.worst_bits for item in load.items),
        "busiest_bits": load.busiest_bits,
        "frames": frames,
    }


def _polled(load: bits.BusLoad, scenario: Scenario, node_ids: list[int]) -> list[Latency]:
    """Latencies of drives without SYNC."""
    table = scenario.bus
    if table.profile == "mit":
        drives = mit_frames(node_ids, table.mit.host_id)
    else:
        drives = moteus_frames(node_ids, table.moteus.host_id)
    worst = {item.name: item.frame_worst_bits for item in load.items}
    return polled_latencies(drives, worst["command"], worst["answer"], load.bitrate / load.rate_hz)


def _largest(found: dict[int, float | None]) -> float | None:
    """The largest latency of one kind; None when there is none, or no bound."""
    values = [value for value in found.values() if value is not None]
    return max(values) if values and len(values) == len(found) else None


def _show(found: dict[str, Any], console: Console) -> None:
    period = 1e6 / found["rate_hz"]
    for bus in found["buses"]:
        console.print(_table(bus, period))
        console.print(_in_time(bus, period), style="dim")
        console.print()
    console.print(
        f"{found['robot']} at {found['rate_hz']:g} Hz and {found['bitrate']} bit/s: "
        f"the controller reads for at most {found['read_budget_us']:.0f} µs of each "
        f"{period:.0f} µs"
    )


def _in_time(bus: dict[str, Any], period: float) -> str:
    """What the latencies mean for the cycle."""
    latency = {frame["role"]: frame["latency_us"] for frame in bus["frames"]}
    answers = latency["answer"]
    commands = latency.get("command", 0.0)  # without SYNC they go out at the next tick
    if answers is None or commands is None:
        return "no bound: the bus is full"
    if "command" not in latency:
        return (
            f"answers come {answers:.0f} µs after the tick at the latest; commands go out at the "
            f"next tick; that leaves {period - answers:.0f} µs to compute"
        )
    left = period - answers - commands
    meaning = (
        f"that leaves {left:.0f} µs to compute"
        if left > 0.0
        else "with both at their worst, a command acts a cycle later"
    )
    return (
        f"answers come {answers:.0f} µs after the tick at the latest; commands handed over "
        f"{commands:.0f} µs before the next tick are in time; {meaning}"
    )


def _table(bus: dict[str, Any], period: float) -> Table:
    title = (
        f"[bold]{bus['name']}[/bold]: {', '.join(bus['joints'])}\n"
        f"load {bus['nominal']:.1%} nominal, {bus['worst']:.1%} worst case, of {period:.0f} µs; "
        f"busiest cycle {bus['busiest_bits']} bits"
    )
    table = Table(
        "frame",
        Column("identifiers", no_wrap=True),
        Column("a cycle", justify="right"),
        Column("bits", justify="right"),
        Column("worst", justify="right"),
        Column("latency\nµs", justify="right"),
        Column("with\nEMCY", justify="right"),
        title=title,
        title_justify="left",
        title_style="",
    )
    for frame in bus["frames"]:
        table.add_row(
            frame["name"],
            _identifiers(frame["identifiers"]),
            f"{frame['per_cycle']:g}",
            f"{frame['nominal_bits']:.1f}",
            f"{frame['worst_bits']:.1f}",
            _us(frame["latency_us"]) if frame["latencies_us"] else "",
            _us(frame["latency_emcy_us"]) if frame["latencies_emcy_us"] else "",
        )
    table.add_section()
    table.add_row("all", "", "", f"{bus['nominal_bits']:.1f}", f"{bus['worst_bits']:.1f}")
    return table


def _identifiers(found: list[int]) -> str:
    if not found:
        return ""
    first, last = f"0x{min(found):03X}", f"0x{max(found):03X}"  # with 29 bits from 800h on
    return first if first == last else f"{first}–{last}"


def _us(latency: float | None) -> str:
    return "none" if latency is None else f"{latency:.0f}"
