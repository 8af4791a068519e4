"""What the page makes of the records in shared memory."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.control import signals
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.log.schema import cycle_layout, rig_layout
from dftc_rt.view import server
from dftc_rt.view.run import LiveRun
from dftc_rt.view.snapshot import Snapshot

JOINTS = ("a", "b")


def test_a_snapshot_reads_every_value_from_its_field() -> None:
    cycle, rig = cycle_layout(JOINTS, signals.NAMES), rig_layout(JOINTS)
    record = np.arange(cycle.size, dtype=float)
    record[cycle.fields.index("state")] = 4.0
    truth = 1000.0 + np.arange(rig.size)
    now = Snapshot.of_records(record, truth, 2)
    at = {name: record[k] for k, name in enumerate(cycle.fields)}
    assert (now.t, now.lateness_s, now.overruns) == (at["t"], at["lateness"], at["overruns"])
    assert now.state == "degraded"
    for name, row in (
        ("q", now.q), ("qd", now.desired), ("rho_hat", now.rho_hat), ("tau_cmd", now.torque),
        ("verdict", now.verdict),
    ):  # fmt: skip
        assert row.tolist() == [at[f"{name}_a"], at[f"{name}_b"]], name
    assert now.rho is not None
    assert now.rho.tolist() == [truth[rig.fields.index("rho_a")], truth[rig.fields.index("rho_b")]]


def test_the_table_names_a_verdict_and_is_silent_about_health() -> None:
    zeros = np.zeros(2)
    now = Snapshot(
        1.0, "run", 0.0, 0, np.array([0.001, 0.0]), zeros, np.array([0.6, np.nan]), zeros,
        np.array([1.0, 4.0]), None,
    )  # fmt: skip
    assert now.table(JOINTS).splitlines()[2:] == [
        "| a | 1.00 | 0.60 |  | actuator loss |",
        "| b | 0.00 | – |  |  |",
    ]


def test_bus_load_is_that_of_the_time_between_two_tellings() -> None:
    told = np.zeros((2, 2))
    run = LiveRun(load_robot("arm2"), lambda: None, lambda: None, ("can0", "can1"), told.copy)
    assert run.now() is None
    assert np.isnan(run.loads()).all()
    told[0] = 2.0, 1.0
    assert run.loads()[0] == 0.5
    assert np.isnan(run.loads()[1])  # not told yet; and the other has not changed
    assert run.loads()[0] == 0.5
    told[0] = 3.0, 1.25
    assert run.loads()[0] == 0.25


def test_without_viser_one_line_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from dftc_rt.cli.main import run

    monkeypatch.setattr(server, "find_spec", lambda name: None)
    assert run(["hil", "ur5_elbow_loss", "--view"]) == 3
    assert capsys.readouterr().err == (
        "dftc: viser is not installed; pip install 'dftc_rt[view]'\n"
    )
