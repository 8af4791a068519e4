"""The bus budget, against sums done by hand."""

from __future__ import annotations

import pytest

from dftc_rt.bus.budget import (
    bus_load,
    buses_needed,
    check,
    joints_per_bus,
    read_budget_s,
)
from dftc_rt.errors import InputError


def test_the_cyclic_traffic_of_three_joints() -> None:
    load = bus_load("can0", 3, rate_hz=1000.0)
    worst = {item.name: item.worst_bits for item in load.items}
    assert worst["SYNC with counter"] == 65
    assert worst["RPDO1 command"] == 3 * 95
    assert worst["TPDO1 position, velocity"] == 3 * 135
    assert worst["TPDO3 torque"] == 75
    # 3 bytes: 47 + 24 + (58 - 1) // 4 = 85 bits, at most 100 times a second and joint.
    assert worst["TPDO2 statusword, mode"] == pytest.approx(3 * 0.1 * 85)
    # 100 SDO transfers a second are 0.2 frames of 135 bits a cycle; 10 heartbeats of 65
    # bits and 10 EMCY of 135 bits a second and joint are 0.01 frames a cycle each; the
    # controller's 20 heartbeats a second are 0.02.
    reserve = 0.2 * 135 + 3 * 0.01 * 65 + 3 * 0.01 * 135 + 0.02 * 65
    assert load.worst_s == pytest.approx((755 + 75 + 25.5 + reserve) * 1e-6)
    assert load.worst == pytest.approx(0.8898)
    nominal = 55 + 3 * 79 + 3 * 111 + 63 + 0.3 * 71 + 0.2 * 111 + 3 * 0.01 * (55 + 111)
    nominal += 0.02 * 55
    assert load.nominal_s == pytest.approx(nominal * 1e-6)


def test_the_busiest_cycle_has_one_of_everything() -> None:
    # SYNC, a TPDO3, an SDO request and response and the controller's heartbeat, and of each
    # joint command, answer, status, heartbeat and EMCY.
    once, each = 65 + 75 + 2 * 135 + 65, 95 + 135 + 85 + 65 + 135
    assert bus_load("can0", 3, rate_hz=1000.0).busiest_bits == once + 3 * each
    # At 50 Hz two TPDO2 of a joint fall into a cycle, and two of the 100 SDO transfers.
    slow = bus_load("can0", 3, rate_hz=50.0)
    assert slow.busiest_bits == once + 2 * 135 + 3 * (each + 85)


def test_more_joints_than_turns_give_two_torques_a_cycle() -> None:
    torque = {
        joints: next(i for i in bus_load("can0", joints, rate_hz=200.0).items if "TPDO3" in i.name)
        for joints in (10, 11)
    }
    assert (torque[10].per_cycle, torque[11].per_cycle) == (1.0, 2.0)


@pytest.mark.parametrize("joints", [(3, 2, 2), (3, 3)])
def test_panda_and_ur5_pass(joints: tuple[int, ...]) -> None:
    check([bus_load(f"can{i}", n, rate_hz=1000.0) for i, n in enumerate(joints)])


def test_four_joints_on_a_bus_are_refused_with_what_would_do() -> None:
    loads = [bus_load("can0", 3, rate_hz=1000.0), bus_load("can1", 4, rate_hz=1000.0)]
    with pytest.raises(InputError) as caught:
        check(loads)
    assert caught.value.where == "bus can1"
    assert str(caught.value) == (
        "bus can1: 4 joints at 1000 Hz need 113% of the period in the worst case"
        " (expected at most 90%: 3 buses would do for 7 joints)"
    )


def test_how_many_buses() -> None:
    assert joints_per_bus(rate_hz=1000.0) == 3
    assert [buses_needed(n, rate_hz=1000.0) for n in (1, 3, 4, 6, 7)] == [1, 1, 2, 2, 3]
    # 2 ms: 65 + 75 + 6 · 230 + 54 (SDO) + 3 (controller's heartbeat) + 6 · (17 + 4) = 1703 bits
    # of 1800; a seventh: 1954.
    assert joints_per_bus(rate_hz=500.0) == 6
    with pytest.raises(InputError, match="not even one joint"):
        buses_needed(1, rate_hz=4000.0)


def test_mit_traffic_is_a_command_and_an_answer_a_joint() -> None:
    assert bus_load("can0", 3, rate_hz=1000.0, profile="mit").worst_s == pytest.approx(810e-6)


def test_the_read_budget_covers_the_answers_and_spares_the_commands() -> None:
    # SYNC 65, three answers of 135, one more frame of 135 already on the wire.
    assert read_budget_s(bus_load("can0", 3, rate_hz=1000.0)) == pytest.approx(605e-6)
    # At 1.25 kHz the period less three commands of 95 bits is shorter than that.
    assert read_budget_s(bus_load("can0", 3, rate_hz=1250.0)) == pytest.approx(515e-6)


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"rate_hz": 0.0}, "executor.rate_hz"),
        ({"rate_hz": float("nan")}, "executor.rate_hz"),
        ({"rate_hz": 1000.0, "bitrate": 0}, "bus.bitrate"),
        ({"rate_hz": 1000.0, "profile": "lin"}, "bus.profile"),
    ],
)
def test_bad_numbers_are_refused(options: dict[str, float], where: str) -> None:
    with pytest.raises(InputError) as caught:
        bus_load("can0", 1, **options)  # type: ignore[arg-type]
    assert caught.value.where == where
