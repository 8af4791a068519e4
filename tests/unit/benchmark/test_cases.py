"""The grid: names, seeds, and settings that a scenario takes."""

from __future__ import annotations

import itertools

import pytest

from dftc_rt.benchmark import cases, conditions
from dftc_rt.benchmark.cases import INTERCONNECTIONS, KINDS, VARIANTS, Group
from dftc_rt.config.calibration import Calibration, JointCalibration
from dftc_rt.config.faults import IntermittentFault, LossFault, RampFault, SineFault, TotalFault
from dftc_rt.config.load import load_scenario
from dftc_rt.control import laws
from hil import SCENARIOS

GROUP = Group("panda", "dftc", "desired", 1.0, "tuning", 100_001)


def test_a_group_for_every_law_and_for_every_interconnection_that_matters() -> None:
    found = cases.groups(
        tuple(conditions.ROBOTS), tuple(VARIANTS), INTERCONNECTIONS, 4.0, "tuning", [1, 2]
    )
    assert len(found) == 2 * 4 * (len(VARIANTS) + 2)
    assert len({group.id for group in found}) == len(found)
    assert {group.momentum_threshold for group in found if group.variant == "momentum"} == {4.0}
    assert {group.momentum_threshold for group in found if group.variant != "momentum"} == {1.0}
    assert {group.interconnection for group in found if group.variant == "eso"} == {"desired"}


def test_names_tell_the_threshold_of_momentum_apart() -> None:
    names = {Group("ur5", "momentum", "desired", x, "tuning", 1).id for x in (1.0, 1.5)}
    assert len(names) == 2
    assert GROUP.case_id("loss40", "panda_joint2") == (
        "panda/dftc/desired/tuning/100001/loss40/panda_joint2"
    )


def test_every_law_is_one() -> None:
    assert {variant.law for variant in VARIANTS.values()} <= set(laws.NAMES)


def test_draws_and_calibration_share_no_seed() -> None:
    spans = [
        conditions.seeds_of(part, draw)
        for part in ("faults", "negative")
        for draw in conditions.DRAWS
    ]
    spans.append((1001, 2000))  # calibration: up to 100 runs, twice
    for (first, last), (start, end) in itertools.combinations(spans, 2):
        assert last < start or end < first


def test_a_seed_beyond_the_draw_is_refused() -> None:
    first, last = conditions.seeds_of("faults", "sealed")
    assert conditions.seed("faults", "sealed", 0) == first
    assert conditions.seed("faults", "sealed", conditions.SEEDS - 1) == last
    with pytest.raises(ValueError, match="99999"):
        conditions.seed("faults", "sealed", conditions.SEEDS)


def calibration() -> Calibration:
    joints = tuple(
        JointCalibration(name=f"j{k}", armature=0.1, gains={"threshold_loss": 10.0 + k})
        for k in range(7)
    )
    return Calibration(robot="panda", joint=joints)


@pytest.mark.parametrize("kind", tuple(KINDS))
def test_settings_of_every_kind_make_a_scenario(kind: str) -> None:
    settings = [
        *conditions.RIG, *cases.run_settings(), cases.fault_setting(kind, "a", "b"),
        *cases.law_settings(GROUP, calibration(), 'folder "x"/panda.toml'),
    ]  # fmt: skip
    found = load_scenario("panda_shoulder_loss", settings, SCENARIOS).scenario
    assert found.seed == found.reference.seed == 100_001
    assert found.control.calibration == 'folder "x"/panda.toml'
    assert found.rig.plant.payload_kg == 1.0
    assert found.duration_s == conditions.END_S
    first = found.fault[0]
    assert first.joint == "a"
    assert first.start_s == conditions.FAULT_S
    match kind, first:
        case "loss20" | "loss40" | "loss70", LossFault(effectiveness=left):
            assert 100 * (1 - left) == pytest.approx(float(kind[4:]))
        case "two", LossFault():
            assert [fault.joint for fault in found.fault] == ["a", "b"]
        case "recovery", LossFault(end_s=end):
            assert end == conditions.RECOVERY_S
        case ("ramp", RampFault()) | ("sine", SineFault()) | ("total", TotalFault()):
            pass
        case "intermittent", IntermittentFault():
            pass
        case _:
            pytest.fail(f"{kind} makes {first}")
    assert (len(found.fault) == 2) == (kind == "two")


def test_the_threshold_of_momentum_is_a_multiple_of_the_calibrated_one() -> None:
    group = Group("panda", "momentum", "desired", 2.0, "tuning", 1)
    settings = cases.law_settings(group, calibration(), "x.toml")
    found = load_scenario("panda_shoulder_loss", settings, SCENARIOS).scenario
    assert found.control.law == "momentum"
    assert found.control.gains["threshold_loss"] == [20.0, 22.0, 24.0, 26.0, 28.0, 30.0, 32.0]


def test_the_gain_can_be_off() -> None:
    group = Group("panda", "dftc_gain_off", "desired", 1.0, "tuning", 1)
    settings = cases.law_settings(group, calibration(), "x.toml")
    found = load_scenario("panda_shoulder_loss", settings, SCENARIOS).scenario
    assert (found.control.law, found.control.ftc) == ("dftc", False)


def test_every_loaded_joint_has_a_partner_unless_it_is_alone() -> None:
    assert cases.partner(["a", "b", "c"], "a") == "b"
    assert cases.partner(["a", "b", "c"], "c") == "a"
    assert cases.partner(["a"], "a") is None
