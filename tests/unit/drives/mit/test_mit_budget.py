"""Load of a bus of MIT drives, and how long the controller waits for them."""

from __future__ import annotations

import pytest

from dftc_rt.bus.budget import bus_load, joints_per_bus, read_budget_s


def test_three_joints_fit_and_four_do_not() -> None:
    # A frame of 8 bytes: 47 + 64 bits and at worst (34 + 64 − 1) // 4 = 24 of stuffing: 135.
    load = bus_load("can0", 3, rate_hz=1000.0, profile="mit")
    assert load.worst_s == pytest.approx(6 * 135e-6)
    assert joints_per_bus(rate_hz=1000.0, profile="mit") == 3


def test_commands_are_in_the_way_of_the_answers() -> None:
    # Two commands, two answers, one more frame already on the wire.
    load = bus_load("can0", 2, rate_hz=1000.0, profile="mit")
    assert read_budget_s(load) == pytest.approx(5 * 135e-6)
    # Three: 945 µs, but a tenth of the period is the law's.
    load = bus_load("can0", 3, rate_hz=1000.0, profile="mit")
    assert read_budget_s(load) == pytest.approx(900e-6)
