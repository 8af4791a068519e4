"""The bus of moteus drives: bits of a cycle, joints on a bus, read budget."""

from __future__ import annotations

import pytest

from dftc_rt.bus.budget import bus_load, buses_needed, check, joints_per_bus, read_budget_s
from dftc_rt.errors import InputError

MOTEUS = "moteus"


def test_a_command_and_an_answer() -> None:
    # 24 bytes, 29 bits: 36 + 13 slow and (36 − 2) div 4 = 8 of stuffing; 5 + 192 + 32 = 229 fast
    # and (36 + 5 + 192 − 2) div 4 − 8 = 49 of stuffing: 57 µs + 278/5 µs = 112.6 µs.
    # 16 bytes: 57 slow; 5 + 128 + 27 = 160 and (36 + 5 + 128 − 2) div 4 − 8 = 33 fast: 95.6 µs.
    load = bus_load("can0", 4, rate_hz=1000.0, profile=MOTEUS)
    assert load.worst_s == pytest.approx(4 * (112.6e-6 + 95.6e-6))
    assert load.worst == pytest.approx(0.8328)
    assert load.nominal_s == pytest.approx(4 * (49 + 229 / 5 + 49 + 160 / 5) * 1e-6)
    assert load.busiest_bits == 833


@pytest.mark.parametrize(
    ("rate_hz", "data_bitrate", "joints"),
    [
        (1000.0, 5_000_000, 4), (500.0, 5_000_000, 8), (1000.0, 2_000_000, 2),
        (500.0, 2_000_000, 5), (1000.0, 1_000_000, 1), (500.0, 1_000_000, 3),
    ],
)  # fmt: skip
def test_joints_on_a_bus(rate_hz: float, data_bitrate: int, joints: int) -> None:
    settings = {"rate_hz": rate_hz, "data_bitrate": data_bitrate, "profile": MOTEUS}
    assert joints_per_bus(**settings) == joints  # type: ignore[arg-type]


def test_panda_takes_two_buses_at_1_khz_and_one_at_500_hz() -> None:
    assert buses_needed(7, rate_hz=1000.0, profile=MOTEUS) == 2
    assert buses_needed(7, rate_hz=500.0, profile=MOTEUS) == 1


def test_read_budget_is_all_frames_and_one_more_but_leaves_a_tenth() -> None:
    load = bus_load("can0", 3, rate_hz=1000.0, profile=MOTEUS)
    assert read_budget_s(load) == pytest.approx((3 * 208.2 + 112.6) * 1e-6)
    assert read_budget_s(bus_load("can0", 4, rate_hz=1000.0, profile=MOTEUS)) == pytest.approx(9e-4)


def test_an_overloaded_bus_names_the_buses_that_would_do_at_its_bit_rates() -> None:
    load = bus_load("can0", 7, rate_hz=1000.0, data_bitrate=2_000_000, profile=MOTEUS)
    with pytest.raises(InputError, match="4 buses would do for 7 joints"):
        check([load], MOTEUS)


def test_data_slower_than_the_rest() -> None:
    with pytest.raises(InputError, match=r"^bus\.data_bitrate: 500000"):
        bus_load("can0", 1, rate_hz=100.0, data_bitrate=500_000, profile=MOTEUS)
