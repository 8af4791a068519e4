"""Runs made by hand: 10 s at 100 Hz, two joints, every signal zero unless a test sets it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dftc_rt.control.signals import NAMES, RHO_HAT, RHO_STD
from dftc_rt.log.run import Run
from dftc_rt.log.schema import cycle_layout, rig_layout
from dftc_rt.rt.supervisor import State

JOINTS = ("a", "b")
RUNNING = float(State.RUN)

Maker = Callable[..., Run]


def make_run(
    scenario: str = "",
    *,
    seconds: float = 10.0,
    rig: bool = True,
    torque_limit: tuple[float, ...] | None = None,
    events: tuple[object, ...] = (),
) -> Run:
    count = round(seconds * 100)
    cycle, truth = cycle_layout(JOINTS, NAMES), rig_layout(JOINTS)
    cycles = np.zeros((count, cycle.size))
    rigs = np.zeros((count, truth.size))
    cycles[:, 0] = rigs[:, 0] = np.arange(count) / 100
    cycles[:, 4] = RUNNING
    run = Run.from_records(
        cycle,
        cycles,
        rigs if rig else None,
        scenario=scenario,
        events=events,  # type: ignore[arg-type]
        torque_limit=torque_limit,
    )
    run.cycle["rho_hat"][:] = 1.0
    run.cycle["rho_std"][:] = 0.01
    if run.rig is not None:
        run.rig["rho"][:] = 1.0
    assert (cycles[:, 7:].reshape(count, 15, 2)[:, RHO_HAT] == 1.0).all()
    assert (cycles[:, 7:].reshape(count, 15, 2)[:, RHO_STD] == 0.01).all()
    return run


@pytest.fixture
def make() -> Maker:
    return make_run
