"""Warming up before a run leaves no trace in it."""

from __future__ import annotations

from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation, warm_up

SETTINGS = ["duration_s=0.3", "rig.plant.q0_rad=[0.1, -0.4, 0.1, -1.9, 0.1, 1.5, 0.6]"]


def test_a_warmed_up_session_gives_the_same_bytes() -> None:
    cold = open_session("panda_shoulder_loss", SETTINGS)
    warm = open_session("panda_shoulder_loss", SETTINGS)
    warm_up(warm)
    (first, _), (second, _) = run_simulation(cold), run_simulation(warm)
    assert first.rig is not None
    assert second.rig is not None
    for name in ("q", "v", "tau_applied"):
        assert first.rig[name].tobytes() == second.rig[name].tobytes()
    for name in ("q", "qd", "tau_cmd", "rho_hat"):
        assert first.cycle[name].tobytes() == second.cycle[name].tobytes()


def test_without_an_initial_pose_the_arm_starts_on_the_reference_warmed_up_or_not() -> None:
    warm = open_session("panda_shoulder_loss", ["duration_s=0.1"])
    warm_up(warm)
    cold, _ = run_simulation(open_session("panda_shoulder_loss", ["duration_s=0.1"]))
    run, _ = run_simulation(warm)
    assert cold.rig is not None
    assert run.rig is not None
    assert run.rig["q"].tobytes() == cold.rig["q"].tobytes()
