import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dftc_rt.drives.scale import JointScale, ScaleTable, quantise_torque, unwrap
from dftc_rt.errors import InputError

SHEETS = [
    JointScale("a", counts_per_rev=1000, gear=100.0, rated_torque_nm=50.0, max_torque_nm=100.0),
    JointScale(
        "b", counts_per_rev=4096, sign=-1, zero_offset_rad=0.5,
        rated_torque_nm=10.0, max_torque_nm=9.9996,
    ),
]  # fmt: skip
TABLE = ScaleTable.of(SHEETS)


def test_units_by_hand() -> None:
    # a: 1000 · 100 counts are one turn of the joint; 25 000 of them a quarter turn.
    # b: 1024 of 4096 counts are a quarter turn, backwards, and q = −π/2 − 0.5.
    counts = np.array([25_000, 1024])
    assert TABLE.position(counts) == pytest.approx([math.pi / 2, -math.pi / 2 - 0.5])
    assert TABLE.velocity(counts) == pytest.approx([math.pi / 2, -math.pi / 2])
    # 1000 per mille is the rated torque, and its sign follows the joint's.
    assert TABLE.torque(np.array([1000, 1000])) == pytest.approx([50.0, -10.0])


def test_most_torque_is_rounded_towards_zero() -> None:
    assert SHEETS[0].max_counts == 2000
    assert SHEETS[1].max_counts == 999  # 999.96 would be more than allowed
    assert SHEETS[1].rated_torque_mnm == 10_000


@given(st.lists(st.floats(-20, 20), min_size=2, max_size=2))
def test_position_there_and_back_within_half_a_count(q: list[float]) -> None:
    back = TABLE.position(TABLE.position_counts(np.array(q)))
    half = np.abs(TABLE.values[0]) / 2
    assert np.all(np.abs(back - q) <= half * (1 + 1e-9) + 1e-12)


@given(st.lists(st.integers(-(2**31) + 1, 2**31 - 1), min_size=1, max_size=20), st.integers())
def test_unwrap_follows_any_motion_below_half_the_range(steps: list[int], start: int) -> None:
    true = start % 2**32 - 2**31
    carried = true
    for step in steps:
        true += step
        raw = (true + 2**31) % 2**32 - 2**31
        if abs(true) > 2**62:
            return
        carried = unwrap(carried, raw)
        assert carried == true


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=2, max_size=2))
def test_quantised_torque_is_limited_and_nearest(tau: list[float]) -> None:
    counts, sent = np.zeros(2, dtype=np.int64), np.zeros(2)
    quantise_torque(np.array(tau), TABLE.values, counts, sent)
    assert np.all(np.abs(counts) <= [2000, 999])
    assert np.array_equal(sent, TABLE.torque(counts))
    for wanted, got, step, most in zip(tau, sent, [0.05, 0.01], [100.0, 9.99], strict=True):
        if math.isnan(wanted):
            assert got == 0.0
        elif abs(wanted) <= most:
            assert abs(got - wanted) <= step / 2 * (1 + 1e-9)
        else:
            assert got == pytest.approx(math.copysign(most, wanted))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("counts_per_rev", 0),
        ("gear", -1.0),
        ("gear", math.nan),
        ("sign", 2),
        ("rated_torque_nm", math.inf),
        ("max_torque_nm", 1e9),  # more per mille than 6071h can say
        ("max_torque_nm", 1e-9),
        ("zero_offset_rad", math.nan),
    ],
)
def test_bad_data_sheet_names_joint_and_key(key: str, value: float) -> None:
    good = {"counts_per_rev": 100, "rated_torque_nm": 1.0, "max_torque_nm": 1.0}
    with pytest.raises(InputError, match=rf"^elbow\.{key}: "):
        JointScale(joint="elbow", **(good | {key: value}))  # type: ignore[arg-type]


def test_gear_ratio_as_integers() -> None:
    sheet = JointScale("a", counts_per_rev=1, rated_torque_nm=1, max_torque_nm=1, gear=50.9)
    assert sheet.gear_ratio == (509, 10)
