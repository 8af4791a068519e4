"""The live status of a run: one line a joint, on standard error."""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from dftc_rt.cli.processes.roles import Rings
from dftc_rt.cli.session import Session
from dftc_rt.control import signals
from dftc_rt.rt.supervisor import State

_LIVE_S = 0.2
_PLAIN_S = 5.0


class Status:
    """Shows the newest record now and then: a table on a terminal, else plain lines."""

    def __init__(self, opened: Session, quiet: bool = False) -> None:
        """Show on standard error; nothing at all when ``quiet``."""
        self._opened = opened
        self._quiet = quiet
        self._console = Console(stderr=True)
        self._live: Live | None = None
        self._next = 0.0

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
        newest = rings.cycle.latest()
        if newest is None:
            return
        if self._live is not None:
            self._next = now + _LIVE_S
            self._live.update(self._table(newest), refresh=True)
        else:
            self._next = now + _PLAIN_S
            print(self._line(newest), file=sys.stderr, flush=True)

    def _record(self, newest: np.ndarray) -> Any:
        header = len(self._opened.cycle.header)
        return newest[header:].reshape(len(signals.NAMES), -1)

    def _line(self, newest: np.ndarray) -> str:
        rec = self._record(newest)
        error = np.abs(rec[signals.Q] - rec[signals.QD]) * 1e3
        worst = int(np.argmax(error))
        joints = self._opened.robot.joints
        marked = [
            f"{joints[i]} {signals.VERDICTS[int(verdict)]} (rho {rec[signals.RHO_HAT, i]:.2f})"
            for i, verdict in enumerate(rec[signals.VERDICT])
            if int(verdict) not in (int(signals.HEALTHY), int(signals.NOT_OBSERVABLE))
        ]
        state = State(int(newest[4])).name.lower().replace("_", " ")
        return (
            f"t {newest[0]:6.1f} s  {state}  lateness {newest[1] * 1e6:.0f} us  "
            f"worst error {error[worst]:.2f} mrad ({joints[worst]})"
            + ("  " + ", ".join(marked) if marked else "")
        )

    def _table(self, newest: np.ndarray) -> Table:
        rec = self._record(newest)
        state = State(int(newest[4])).name.lower().replace("_", " ")
        table = Table(
            title=f"t {newest[0]:.1f} s   {state}   lateness {newest[1] * 1e6:.0f} us",
            title_justify="left",
        )
        for name in ("joint", "error / mrad", "rho", "", "verdict", "torque / Nm"):
            table.add_column(name, justify="left" if name in ("joint", "verdict", "") else "right")
        limits = self._opened.parts.torque_limit
        for i, joint in enumerate(self._opened.robot.joints):
            rho = rec[signals.RHO_HAT, i]
            verdict = int(rec[signals.VERDICT, i])
            style = {0: "green", 4: "dim"}.get(verdict, "bold red")
            bar = "" if np.isnan(rho) else "█" * round(10 * min(max(rho, 0.0), 1.0))
            table.add_row(
                joint,
                f"{(rec[signals.Q, i] - rec[signals.QD, i]) * 1e3:.2f}",
                f"{rho:.2f}",
                bar,
                Text(signals.VERDICTS[verdict], style=style),
                f"{rec[signals.TAU_CMD, i]:.1f} / {limits[i]:.0f}",
            )
        return table
