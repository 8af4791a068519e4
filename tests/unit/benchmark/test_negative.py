"""The negative set: motion within limits, disturbances that are no faults, and alarms counted."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.analysis.faults import ACTUATOR_KINDS
from dftc_rt.benchmark import negative
from dftc_rt.benchmark.conditions import NEGATIVE_S, RIG
from dftc_rt.benchmark.negative import ITEMS, Item, item_settings, measure_negative
from dftc_rt.config.faults import ContactFault, FrictionFault, PayloadFault
from dftc_rt.config.load import load_scenario
from dftc_rt.config.scenario import Scenario
from dftc_rt.control.signals import ACTUATOR_LOSS, ANOMALY, NOT_OBSERVABLE
from dftc_rt.reference import Reference
from hil import SCENARIOS
from tests.unit.benchmark.test_measure import SCENARIO, H, T, made

HOME = np.array([0.0, -1.2, 1.5, -1.9, -1.57, 0.0])
LOWER, UPPER = np.full(6, -3.0), np.array([np.inf, 3.0, 1.6, 3.0, 3.0, 3.0])


def scenario(item: Item, seed: int = 5) -> Scenario:
    settings = [*RIG, *item_settings(item, seed, HOME, LOWER, UPPER)]
    return load_scenario("ur5_elbow_loss", settings, SCENARIOS).scenario


def test_twelve_trajectories_come_first_and_names_are_unique() -> None:
    assert all(item.fault == "[]" for item in ITEMS[:12])
    assert len({item.name for item in ITEMS}) == len(ITEMS) <= 32


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: item.name)
def test_every_item_is_a_scenario_without_a_fault_of_an_actuator(item: Item) -> None:
    found = scenario(item)
    assert found.duration_s == NEGATIVE_S
    kinds = {type(fault).__struct_config__.tag for fault in found.fault}
    assert not kinds & ACTUATOR_KINDS
    q = Reference(found.reference, HOME).table(np.arange(0.0, NEGATIVE_S, 0.05))[:, 0]
    assert np.all(q > LOWER)
    assert np.all(q < UPPER) or item.motion != "moves"  # others are made smaller until they fit
    assert (np.ptp(q, axis=0) > 0.05).all() == (item.motion != "hold")


def test_what_disturbs_is_as_it_should_be() -> None:
    by_name = {item.name: scenario(item).fault for item in ITEMS}
    (half,), (one,) = by_name["payload 0.5 kg"], by_name["payload 1 kg"]
    assert isinstance(half, PayloadFault)
    assert isinstance(one, PayloadFault)
    assert (half.payload_kg, one.payload_kg) == (0.5, 1.0)
    (friction,) = by_name["friction x 1.5"]
    assert isinstance(friction, FrictionFault)
    assert friction.factor == 1.5
    contacts = by_name["contacts"]
    assert len({fault.force_n for fault in contacts if isinstance(fault, ContactFault)}) == 6
    for fault in contacts:
        assert isinstance(fault, ContactFault)
        assert np.linalg.norm(fault.force_n) == 20.0
        assert fault.end_s - fault.start_s == pytest.approx(0.3)


def test_moves_are_repeatable_and_of_their_seed() -> None:
    item = next(item for item in ITEMS if item.motion == "moves")
    first = item_settings(item, 1, HOME, LOWER, UPPER)
    assert first == item_settings(item, 1, HOME, LOWER, UPPER)
    assert first != item_settings(item, 2, HOME, LOWER, UPPER)


def test_alarms_of_a_run() -> None:
    run = made(SCENARIO)
    verdict, rho = run.cycle["verdict"], run.cycle["rho_hat"]
    verdict[:, 1] = NOT_OBSERVABLE  # no anomaly
    verdict[(T >= 2.0) & (T < 2.5), 0] = ANOMALY
    verdict[(T >= 2.5) & (T < 3.0), 0] = ACTUATOR_LOSS
    verdict[(T >= 5.0) & (T < 5.5), 0] = ACTUATOR_LOSS
    rho[(T >= 5.0) & (T < 5.2), 0] = 0.8
    run.cycle["qd"][:, 1] = 4e-3
    found = measure_negative(run, "attributed", H)
    assert found["false_alarms"] == 2
    assert found["false_alarm_s"] == pytest.approx(1.0, abs=3e-3)
    assert found["wrong_gain_s"] == pytest.approx(0.2, abs=3e-3)
    assert found["anomalies"] == 2
    assert found["anomaly_s"] == pytest.approx(1.5, abs=3e-3)
    assert found["joints"] == "a"
    assert found["worst_mrad"] == pytest.approx(4.0)


def test_an_alarm_counts_while_the_controller_runs() -> None:
    run = made(SCENARIO)
    run.cycle["verdict"][T >= 7.0, 0] = ACTUATOR_LOSS
    run.cycle["state"][T >= 6.5] = 7.0
    assert measure_negative(run, "attributed", H)["false_alarms"] == 0


def test_what_is_raised_at_the_start_is_entered() -> None:
    raised = np.array([[1, 0], [1, 1], [0, 1], [1, 1]], dtype=np.bool_)
    assert negative.entries(raised) == 3
