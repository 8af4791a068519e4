"""``python -m tests.integration.reactions``: the times of docs/safety.md, in lock-step.

For each fault of a Panda in motion: rig time from its beginning until no joint has torque or
moves, by the rig's own account.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.control import signals
from dftc_rt.rt.supervisor import State

START_S = 2.0
FAULTS = {
    "drive in fault, EMCY": '{joint="panda_joint2", kind="emcy", error_code=0x4310, start_s=2}',
    "drive's supply gone, restart": '{joint="panda_joint2", kind="restart", start_s=2}',
    "node silent": '{joint="panda_joint2", kind="silent", start_s=2}',
    "controller off one bus of three": '{bus="can1", kind="bus_off", start_s=2}',
    "actuator all but lost": '{joint="panda_joint2", kind="total", start_s=2}',
    "joint blocked": '{joint="panda_joint2", kind="lock", start_s=2}',
    "encoder stands still": '{joint="panda_joint2", kind="sensor_frozen", start_s=2}',
}


def nan(rec: Any) -> None:
    rec[signals.TAU_CMD, 3] = np.nan


def too_much(rec: Any) -> None:
    rec[signals.TAU_CMD, 3] = 1e6


def raises(rec: Any) -> None:
    raise ZeroDivisionError("in a law")


LAWS: dict[str, Callable[[Any], None]] = {
    "law writes NaN": nan, "law asks for 1e6 Nm": too_much, "law raises": raises,
}  # fmt: skip


def broken(update: Callable[..., int], then: Callable[[Any], None], calls: list[int]) -> Any:
    """Return a law's update that does something else from START_S on."""

    @functools.wraps(update)
    def wrapped(rec: Any, *rest: Any) -> int:
        calls[0] += 1
        status = update(rec, *rest)
        if calls[0] > START_S * 1e3:
            then(rec)
        return status

    return wrapped


def measure(fault: str, then: Callable[[Any], None] | None) -> tuple[str, str]:
    """Run it; return (ms until safe, what the run said)."""
    opened = open_session("panda_shoulder_loss", ["duration_s=3.5", f"fault=[{fault}]"])
    law: Any = opened.parts.law
    if then is not None:
        law.update = broken(law.update, then, [0])
    run, outcome = run_simulation(opened, progress=False)
    assert run.rig is not None
    busy = (run.rig["tau_applied"] != 0.0) | (run.rig["v"] != 0.0)
    last = float(run.rig["t"][np.flatnonzero(busy.any(axis=1))[-1]])
    # A law fails in the last cycle in which the arm follows its reference.
    following = run.cycle["t"][np.isin(run.cycle["state"], (State.RUN, State.DEGRADED))]
    begun = START_S if then is None else float(following[-1])
    return f"{1e3 * (last - begun):.0f}", outcome.reason


def main() -> None:
    """Print a row a fault."""
    for name, fault in FAULTS.items():
        print("{:34}{:>6} ms  {}".format(name, *measure(fault, None)), flush=True)
    for name, then in LAWS.items():
        print("{:34}{:>6} ms  {}".format(name, *measure("", then)), flush=True)


if __name__ == "__main__":
    main()
