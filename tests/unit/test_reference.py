"""The reference: its derivatives, its blend, its limits, and refused input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dftc_rt.config.scenario import ReferenceTable
from dftc_rt.errors import InputError
from dftc_rt.reference import Reference, stop_ramp

HOME2 = np.array([0.2, -0.4])
WAYPOINTS = ReferenceTable(
    kind="waypoints",
    times_s=(0.0, 1.0, 2.5),
    positions_rad=((0.0, 0.0), (0.5, -0.2), (-0.1, 0.3)),
    blend_s=0.0,
)


def _csv_table(tmp_path: Path) -> ReferenceTable:
    path = tmp_path / "r.csv"
    t = np.linspace(0, 3, 31)
    rows = "\n".join(f"{x},{np.sin(x)},{np.cos(2 * x)}" for x in t)
    path.write_text("t,a,b\n" + rows)
    return ReferenceTable(kind="csv", file=str(path), blend_s=0.5)


@pytest.mark.parametrize("kind", ["hold", "sine", "multisine", "paper1", "paper2", "way", "csv"])
def test_velocity_and_acceleration_are_derivatives(kind: str, tmp_path: Path) -> None:
    if kind == "way":
        table = WAYPOINTS
    elif kind == "csv":
        table = _csv_table(tmp_path)
    else:
        frequency = 0.4 if kind == "sine" else (0.1, 0.5)
        table = ReferenceTable(kind=kind, frequency_hz=frequency, blend_s=1.0)  # type: ignore[arg-type]
    reference = Reference(table, HOME2)
    reference.start(np.array([0.1, 0.7]))
    h = 1e-5
    for t in (0.213, 0.777, 1.302, 2.211):
        low, mid, high = reference.table(np.array([t - h, t, t + h]))
        np.testing.assert_allclose((high[0] - low[0]) / (2 * h), mid[1], atol=1e-6)
        np.testing.assert_allclose((high[1] - low[1]) / (2 * h), mid[2], atol=1e-5)


def test_paper2_is_the_printed_reference() -> None:
    out = Reference(ReferenceTable(kind="paper2", blend_s=0.0), HOME2).table(np.array([0.7]))[0]
    t = 0.7
    expected = [0.5 * np.cos(t) + 0.2 * np.sin(3 * t), 0.3 * np.cos(3 * t) - 0.5 * np.sin(2 * t)]
    np.testing.assert_allclose(out[0], expected, atol=1e-15)


def test_blend_starts_at_rest_at_the_measured_pose_and_ends_on_the_reference() -> None:
    table = ReferenceTable(kind="multisine", blend_s=1.5)
    pose = np.array([1.0, -1.0])
    blended, plain = Reference(table, HOME2), Reference(table, HOME2)
    blended.start(pose)
    first = blended.table(np.array([0.0]))[0]
    np.testing.assert_array_equal(first[0], pose)
    np.testing.assert_array_equal(first[1:], 0.0)
    plain.start(np.zeros(2))
    np.testing.assert_array_equal(
        blended.table(np.array([1.5, 9.0])), plain.table(np.array([1.5, 9.0]))
    )


def test_multisine_never_exceeds_its_amplitude() -> None:
    table = ReferenceTable(kind="multisine", amplitude_rad=(0.3, 0.1), blend_s=0.0)
    q = Reference(table, HOME2).table(np.linspace(0, 60, 6001))[:, 0]
    assert np.all(np.abs(q - HOME2).max(axis=0) <= [0.3, 0.1])
    assert np.all(np.abs(q - HOME2).max(axis=0) >= [0.15, 0.05])


def test_stop_ramp_is_continuous_and_ends_at_rest() -> None:
    start = np.array([[0.3, -0.2], [1.0, -0.5]])
    at = [np.empty((3, 2)) for _ in range(4)]
    for out, t in zip(at, (0.0, 0.2, 0.2 + 1e-6, 0.5), strict=True):
        stop_ramp(t, 0.4, start, out)
    np.testing.assert_allclose(at[0][:2], start)
    np.testing.assert_allclose((at[2][0] - at[1][0]) / 1e-6, at[1][1], atol=1e-5)
    np.testing.assert_allclose((at[2][1] - at[1][1]) / 1e-6, at[1][2], atol=1e-4)
    np.testing.assert_array_equal(at[3][1:], 0.0)


@pytest.mark.parametrize(
    ("table", "where"),
    [
        (ReferenceTable(amplitude_rad=(0.1, 0.2, 0.3)), "reference.amplitude_rad"),
        (ReferenceTable(kind="sine"), "reference.frequency_hz"),
        (ReferenceTable(frequency_hz=(0.5, 0.1)), "reference.frequency_hz"),
        (ReferenceTable(kind="waypoints", times_s=(0.0,)), "reference.times_s"),
        (ReferenceTable(kind="waypoints", times_s=(0.0, 1.0)), "reference.positions_rad"),
        (ReferenceTable(kind="csv"), "reference.file"),
        (ReferenceTable(kind="csv", file="/nowhere.csv"), "reference.file"),
    ],
)
def test_bad_input_is_refused_with_its_key(table: ReferenceTable, where: str) -> None:
    with pytest.raises(InputError) as caught:
        Reference(table, HOME2)
    assert caught.value.where == where


def test_paper_references_want_two_joints() -> None:
    with pytest.raises(InputError, match="3 joints"):
        Reference(ReferenceTable(kind="paper1"), np.zeros(3))
