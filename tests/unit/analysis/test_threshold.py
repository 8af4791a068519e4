"""The threshold of the residual is where the law's own test changes sign."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dftc_rt.analysis.threshold import residual_threshold
from dftc_rt.analysis.traffic import bus_traffic
from dftc_rt.control.decision import log_likelihood_ratio

from .conftest import Maker

DFTC = '[control]\nlaw = "dftc"\n'


def test_beyond_it_the_evidence_for_a_loss_grows_and_within_it_does_not(make: Maker) -> None:
    run = make(DFTC, torque_limit=(100.0, 100.0))
    run.cycle["tau_cmd"][:, 0] = -20.0
    found = residual_threshold(run)
    assert found is not None
    settled = found[-1, 0]
    assert settled == pytest.approx(2.0)  # half of rho_step = 0.2, of 20 Nm
    phi = -20.0
    for residual, grows in ((settled * 1.01, True), (settled * 0.99, False)):
        assert (log_likelihood_ratio(phi, phi + residual, 0.8, 1.0) > 0.0) is grows
        assert (log_likelihood_ratio(phi, phi - residual, 1.2, 1.0) > 0.0) is grows


def test_there_is_none_while_the_torque_is_too_small_to_tell(make: Maker) -> None:
    run = make(DFTC, torque_limit=(100.0, 100.0))
    run.cycle["tau_cmd"][:, 0] = 2.3  # least: 3 * (0.1 + 0.007 * 100) = 2.4 Nm
    run.cycle["tau_cmd"][:, 1] = 2.5
    found = residual_threshold(run)
    assert found is not None
    assert np.isnan(found[:, 0]).all()
    assert np.isfinite(found[-1, 1])


def test_the_filter_is_that_of_the_residual(make: Maker) -> None:
    run = make(DFTC + "[control.gains]\nbandwidth = 10.0\n", torque_limit=(1.0, 1.0))
    run.cycle["tau_cmd"][500:, 0] = 10.0
    found = residual_threshold(run)
    assert found is not None
    assert found[511, 0] == pytest.approx(1.0 - np.exp(-1.1), rel=0.1)  # 0.1 s later


def test_settings_come_from_robot_calibration_and_scenario_in_that_order(make: Maker) -> None:
    run = make(DFTC, torque_limit=(1.0, 1.0))
    run.cycle["tau_cmd"][:] = 10.0

    def last(run: object) -> list[float]:
        found = residual_threshold(run)  # type: ignore[arg-type]
        assert found is not None
        return [float(x) for x in found[-1]]

    robot = b"[gains]\nrho_step = 0.4\n"
    calibration = b"".join(
        f'[[joint]]\nname = "{j}"\n[joint.gains]\nrho_step = {x}\n'.encode()
        for j, x in (("a", 0.1), ("b", 0.3))
    )
    run = dataclasses.replace(run, attachments={"robot.toml": robot})
    assert last(run) == pytest.approx([2.0, 2.0])
    run = dataclasses.replace(
        run, attachments={"robot.toml": robot, "calibration.toml": calibration}
    )
    assert last(run) == pytest.approx([0.5, 1.5])
    run = dataclasses.replace(run, scenario=DFTC + "[control.gains]\nrho_step = 0.6\n")
    assert last(run) == pytest.approx([3.0, 3.0])


@pytest.mark.parametrize(
    "scenario",
    [
        "",
        '[control]\nlaw = "eso"\n',
        '[control]\nlaw = "mine:Law"\n',
        DFTC + '[control.gains]\nobserver = "printed"\n',
        DFTC + '[control.gains]\nrho_step = "no number"\n',
    ],
)
def test_a_law_that_does_not_test_its_residual_has_none(make: Maker, scenario: str) -> None:
    assert residual_threshold(make(scenario)) is None


@pytest.mark.parametrize("torn", [b"\xff\xfe", b"gains = 3", b"[gains", b"gains = [1, 2]"])
def test_a_robot_file_that_is_damaged_gives_none(make: Maker, torn: bytes) -> None:
    """Found by fuzzing: what is drawn would be a guess."""
    run = make(DFTC)
    torn_run = dataclasses.replace(run, attachments={"robot.toml": torn})
    assert residual_threshold(torn_run) is None
    assert bus_traffic(torn_run) == []
