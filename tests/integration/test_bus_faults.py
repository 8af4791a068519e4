"""What faults of a bus do to a controlled arm, in lock-step; the truth is the rig's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation

SAFE_S = 2.0 + 0.020 + 0.001  # fault, watchdog or stale_cycles, one cycle
BASE = ("duration_s=4", "rig.drive.watchdog_s=0.02")


def simulated(*faults: str) -> tuple[Any, Any]:
    opened = open_session("panda_shoulder_loss", [*BASE, f"fault=[{', '.join(faults)}]"])
    return run_simulation(opened, progress=False)


def still_moving_s(run: Any) -> float:
    """Return when, in rig time, some joint last had torque or moved."""
    busy = (np.asarray(run.rig["tau_applied"]) != 0.0) | (np.asarray(run.rig["v"]) != 0.0)
    return float(np.asarray(run.rig["t"])[np.flatnonzero(busy.any(axis=1))[-1]])


def worst_error(run: Any) -> float:
    """Largest tracking error after 2 s, mrad, by the rig's own account of the positions."""
    own, at = np.asarray(run.cycle["t"]), np.asarray(run.rig["t"])
    late = (own > 2.0) & (own < 3.99)
    rows = np.searchsorted(at, own[late] - 5e-4)
    error = np.asarray(run.rig["q"])[rows] - np.asarray(run.cycle["qd"])[late]
    return float(1e3 * np.abs(error).max())


@pytest.mark.parametrize(
    "fault",
    [
        '{kind="frame_loss", bus="can0", probability=0.01, start_s=2}',
        '{kind="frame_corruption", bus="can0", probability=0.05, start_s=2}',
        '{kind="frame_corruption", bus="can0", probability=0.01, retransmit=false, start_s=2}',
        '{kind="frame_delay", bus="can0", delay_s=0.0015, probability=0.02, start_s=2}',
        '{kind="frame_duplication", bus="can0", probability=0.1, start_s=2}',
        '{kind="babble", bus="can0", can_id=0x7ff, rate_hz=1000.0, start_s=2}',
    ],
)
def test_the_arm_goes_on(fault: str) -> None:
    run, outcome = simulated(fault)
    assert outcome.reason == ""
    assert worst_error(run) < 1.0  # 0.25 without a fault
    assert not (np.asarray(run.cycle["verdict"]) == 1).any()


def test_a_lossy_run_repeats_bit_for_bit() -> None:
    fault = '{kind="frame_loss", bus="can1", probability=0.05, start_s=1}'
    first, second = simulated(fault)[0], simulated(fault)[0]
    for name in ("tau_cmd", "q", "rho_hat"):
        np.testing.assert_array_equal(first.cycle[name], second.cycle[name])


def test_a_controller_off_the_bus_stops_the_arm() -> None:
    run, outcome = simulated('{kind="bus_off", bus="can1", start_s=2.0, end_s=2.5}')
    # The interface says so itself; nobody waits until the answers are stale.
    assert outcome.reason.startswith("can1: bus-off")
    assert "restart-ms 100" in outcome.reason
    began = np.asarray(run.cycle["t"])[np.asarray(run.cycle["state"]) == 6]
    assert began[0] - 2.0 < 0.005
    assert np.asarray(run.cycle["t"])[-1] < 3.5
    speed = np.abs(np.asarray(run.rig["v"])[-1])
    assert speed.max() < 0.05


@pytest.mark.parametrize("keys", ["kind='frame_loss'", "kind='frame_corruption', retransmit=false"])
def test_a_tenth_of_all_frames_lost_on_all_buses_is_survived(keys: str) -> None:
    run, outcome = simulated(
        *(f"{{{keys}, bus='can{bus}', probability=0.1, start_s=2}}" for bus in range(3))
    )
    assert outcome.reason == ""
    assert outcome.counters.missed > 1000
    assert worst_error(run) < 5.0
    assert not (np.asarray(run.cycle["verdict"]) == 1).any()
