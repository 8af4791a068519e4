"""The live status of a run on standard error: a table on a terminal, plain lines elsewhere.

All of it happens in the launcher, from what the other processes leave in shared memory.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from dftc_rt.cli.processes.roles import Rings
from dftc_rt.cli.session import Session
from dftc_rt.control import signals
from dftc_rt.controller import bus_loads
from dftc_rt.rt.supervisor import State
from hil.bus.statistics import busy_s

_LIVE_S = 0.2
_PLAIN_S = 5.0
_SHARE = 20.0  # the table takes at most one part in so many of a core
_BAR = 8
_FULL = 0.9  # of the torque limit: shown in red
_COLUMNS = {
    "joint": 16, "error\nmrad": 8, "ρ̂": 5, " ": _BAR, "verdict": 15, "torque\nNm": 7,
    "limit\n%": 5, "  ": _BAR,
}  # fmt: skip
"""Heading and greatest width; 79 with the gaps between them."""


@dataclass(frozen=True)
class Shown:
    """What the status shows of a run at one moment.

    Attributes:
        record: The newest record of ``/cycle``.
        rate_hz: Cycles per second since the last look; None at the first.
        loads: Bus name -> share of the time in which its wire was occupied since the last
            look; empty where nobody counts.
    """

    record: NDArray[np.float64]
    rate_hz: float | None
    loads: Mapping[str, float]


class Status:
    """Shows the newest record now and then: a table on a terminal, else plain lines."""

    def __init__(self, opened: Session, quiet: bool = False) -> None:
        """Show on standard error; nothing at all when ``quiet``."""
        self._opened = opened
        self._quiet = quiet
        self._console = Console(stderr=True)
        self._live: Live | None = None
        self._next = 0.0
        self._before: tuple[float, int, NDArray[np.float64]] | None = None
        loads = bus_loads(opened.scenario, opened.robot)
        self._planned = {load.name: load.nominal for load in loads}

    def __enter__(self) -> Status:
        if sys.stderr.isatty() and not self._quiet:
            self._live = Live(console=self._console, auto_refresh=False, transient=True)
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def watch(self, rings: Rings) -> None:
        """Show the newest record, if it is time to."""
        now = time.monotonic()
        if self._quiet or now < self._next:
            return
        shown = self.look(rings, now)
        if shown is None:
            return
        if self._live is not None:
            self._live.update(self.table(shown), refresh=True)
            spent = time.monotonic() - now
            self._next = now + max(_LIVE_S, _SHARE * spent)
        else:
            self._next = now + _PLAIN_S
            print(self.line(shown), file=sys.stderr, flush=True)

    def look(self, rings: Rings, now: float) -> Shown | None:
        """Take the newest record, and what has happened since the last look.

        Args:
            rings: Shared memory of the run.
            now: Monotonic time, s.

        Returns:
            None before the first record.
        """
        newest = rings.cycle.latest()
        if newest is None:
            return None
        bus = self._opened.scenario.bus
        cycles = rings.cycle.written + rings.cycle.dropped
        busy = busy_s(rings.traffic, bus.bitrate, bus.data_bitrate)
        rate, loads = None, {}
        if self._before is not None and now > self._before[0]:
            span = now - self._before[0]
            rate = (cycles - self._before[1]) / span
            if busy.any():
                shares = (busy - self._before[2]) / span
                loads = dict(zip(self._opened.can.buses, shares.tolist(), strict=True))
        self._before = (now, cycles, busy)
        return Shown(newest, rate, loads)

    def _record(self, newest: NDArray[np.float64]) -> Any:
        header = len(self._opened.cycle.header)
        return newest[header:].reshape(len(signals.NAMES), -1)

    def _facts(self, shown: Shown) -> list[str]:
        """Time, state, rate, lateness, bus load."""
        newest = shown.record
        rate = "" if shown.rate_hz is None else f"{shown.rate_hz:.0f} cycles/s"
        loads, note = (shown.loads, "") if shown.loads else (self._planned, " planned")
        told = " ".join(f"{name} {100 * load:.0f} %" for name, load in loads.items())
        state = State(int(newest[4])).name.lower().replace("_", " ")
        parts = [
            f"t {newest[0]:6.1f} s", state, rate, f"lateness {newest[1] * 1e6:.0f} us",
            f"overruns {newest[5]:.0f}" if newest[5] else "", f"{told}{note}",
        ]  # fmt: skip
        return [part for part in parts if part]

    def line(self, shown: Shown) -> str:
        """The status in one line."""
        rec = self._record(shown.record)
        error = np.abs(rec[signals.Q] - rec[signals.QD]) * 1e3
        worst = int(np.argmax(error))
        joints = self._opened.robot.joints
        marked = [
            f"{joints[i]} {signals.VERDICTS[int(verdict)]} (rho {rec[signals.RHO_HAT, i]:.2f})"
            for i, verdict in enumerate(rec[signals.VERDICT])
            if int(verdict) not in (int(signals.HEALTHY), int(signals.NOT_OBSERVABLE))
        ]
        worst_joint = f"worst error {error[worst]:.2f} mrad ({joints[worst]})"
        return "  ".join([*self._facts(shown), worst_joint, *marked])

    def table(self, shown: Shown) -> Group:
        """The status as a table, a row a joint, for 80 columns."""
        rec = self._record(shown.record)
        table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
        for name, width in _COLUMNS.items():
            left = name in ("joint", "verdict") or not name.strip()
            table.add_column(
                name, justify="left" if left else "right", no_wrap=True, max_width=width
            )
        limits = self._opened.parts.torque_limit
        for i, joint in enumerate(self._opened.robot.joints):
            rho, torque = rec[signals.RHO_HAT, i], rec[signals.TAU_CMD, i]
            verdict = int(rec[signals.VERDICT, i])
            style = {0: "green", 4: "dim"}.get(verdict, "bold red")
            share = abs(torque) / limits[i]
            table.add_row(
                Text(joint),
                f"{(rec[signals.Q, i] - rec[signals.QD, i]) * 1e3:.2f}",
                "–" if np.isnan(rho) else f"{rho:.2f}",
                _bar(rho, style),
                Text(signals.VERDICTS[verdict], style=style),
                f"{torque:.1f}",
                f"{100 * share:.0f}",
                _bar(share, "red" if share > _FULL else "blue"),
            )
        *facts, load = self._facts(shown)
        return Group(Text("   ".join(facts), style="bold"), Text(f"bus load: {load}"), table)


def _bar(share: float, style: str) -> Text:
    """A bar of ten cells; empty for what is no number."""
    cells = 0 if np.isnan(share) else round(_BAR * min(max(share, 0.0), 1.0))
    return Text("█" * cells + "·" * (0 if np.isnan(share) else _BAR - cells), style=style)
