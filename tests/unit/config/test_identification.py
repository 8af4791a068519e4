"""Identification files: what is refused, each in one line, without running what is in them."""

import contextlib
import dataclasses
import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dftc_rt.cli.main import run as command
from dftc_rt.cli.session import open_session
from dftc_rt.config.calibration import Calibration, JointCalibration, LinkLoad
from dftc_rt.config.identification import (
    Identification,
    fingerprint,
    load_identification,
    save_identification,
)
from dftc_rt.config.npz import MOST_BYTES
from dftc_rt.control.dftc import Dftc
from dftc_rt.controller import prepare
from dftc_rt.errors import InputError

SCENARIO = "paper_example2_urdf"


@pytest.fixture(scope="module")
def good() -> Identification:
    opened = open_session(SCENARIO, ["control.law=dftc", "control.gains={}"])
    law = opened.parts.law
    assert isinstance(law, Dftc)
    joints = law.joints
    rng = np.random.default_rng(1)
    return Identification(
        robot="arm2",
        joints=opened.robot.joints,
        grid=(3, 4),
        width=1.0,
        q_range=np.column_stack([joints.q_lower, joints.q_upper]),
        v_range=joints.velocity_limit.copy(),
        w_fo=rng.normal(size=(2, 12)),
        w_go=0.01 * rng.normal(size=(2, 12)),
        visited=np.ones((2, 12), dtype=bool),
        interconnection="desired",
        calibration="",
        source="test",
        seconds=1.0,
    )


@pytest.fixture
def path(good: Identification, tmp_path: Path) -> Path:
    target = tmp_path / "good.npz"
    save_identification(target, good)
    return target


def _simulate(path: Path, *more: str) -> int:
    sets = ("control.law=dftc", f"control.identification={path}", "duration_s=0.05", *more)
    return command(["simulate", SCENARIO, *(w for s in sets for w in ("--set", s))])


def _arrays(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as found:
        return dict(found)


def _refused(path: Path, expected: str, capsys: pytest.CaptureFixture[str], *more: str) -> None:
    capsys.readouterr()
    assert _simulate(path, *more) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1


def test_a_file_comes_back_as_it_was(good: Identification, path: Path) -> None:
    found = load_identification(path)
    for field in dataclasses.fields(Identification):
        np.testing.assert_array_equal(getattr(found, field.name), getattr(good, field.name))
    again = path.with_name("again.npz")
    save_identification(again, found)
    assert again.read_bytes() == path.read_bytes()


def test_a_good_file_is_taken(path: Path) -> None:
    assert _simulate(path) == 0


@pytest.mark.parametrize("in_law", [False, True])
def test_the_networks_reach_the_observer_and_the_law_if_wanted(
    path: Path, good: Identification, in_law: bool
) -> None:
    sets = ["control.law=dftc", f"control.identification={path}"]
    opened = open_session(SCENARIO, [*sets, f"control.identification_in_law={str(in_law).lower()}"])
    law = opened.parts.law
    assert isinstance(law, Dftc)
    weights = law.storage.initial_weights
    own = np.stack([good.w_fo, good.w_go], axis=1)
    np.testing.assert_array_equal(weights[:, 2:], own)
    np.testing.assert_array_equal(weights[:, :2], own if in_law else 0 * own)
    assert np.all(law.storage.parameters["use_basis"] == 1)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("format", np.int64(2), "format: found 2"),
        ("robot", np.asarray("ur5"), "robot: found 'ur5' (expected 'arm2')"),
        ("joints", np.asarray(["a", "b"]), "joints: found a, b"),
        ("joints", np.asarray(["a"] * 65), "1 to 64 names"),
        ("grid", np.asarray([3, 5]), "shape (2, 12)"),
        ("grid", np.asarray([0, 5]), "1 to 99 points"),
        ("grid", np.asarray([3.0, 4.0]), "grid: found float64 (expected integers)"),
        ("width", np.float64(-1.0), "negative or 0"),
        ("width", np.float64(np.inf), "width: a value is not finite"),
        ("w_fo", np.full((2, 12), np.nan), "w_fo: a value is not finite"),
        ("w_fo", np.full((2, 12), 1e300), "w_fo: found 1e+300 (expected at most 10000)"),
        ("w_go", np.full((2, 12), -11.0), "w_go: found 11 (expected at most 10)"),
        ("w_fo", np.zeros((3, 12)), "w_fo: shape (3, 12) (expected (2, 12))"),
        ("visited", np.zeros((2, 12)), "visited: found float64 (expected booleans)"),
        ("q_range", np.zeros((2, 2)), "an empty range"),
        ("v_range", np.asarray([7.0, 7.0]), "a grid over"),
        ("interconnection", np.asarray("frozen"), "trained with 'frozen'"),
        ("interconnection", np.asarray("x"), "interconnection: found 'x'"),
        ("calibration", np.asarray("0123456789abcdef"), "trained with calibration 01234567"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(
    name: str, value: Any, expected: str, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savez(path, **(_arrays(path) | {name: value}))
    _refused(path, expected, capsys)


class _Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return (Path("unpickled").touch, ())


def test_nothing_is_unpickled(
    path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(path.parent)
    objects = np.empty((2, 12), dtype=object)
    objects[:] = _Bomb()
    np.savez(path, **(_arrays(path) | {"w_fo": objects}))
    _refused(path, "w_fo: found object", capsys)
    path.write_bytes(pickle.dumps(_Bomb()))
    _refused(path, "is no NPZ archive, or damaged", capsys)
    assert not Path("unpickled").exists()


def _replace_member(path: Path, name: str, data: bytes) -> None:
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    members[name] = data
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, content in members.items():
            archive.writestr(each, content)


def test_sizes_that_lie_are_refused(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = io.BytesIO()
    np.lib.format.write_array(whole, np.zeros((2, 12)))
    lying = whole.getvalue().replace(b"(2, 12)", b"(2**9,)")
    _replace_member(path, "w_fo.npy", lying)
    _refused(path, "is no NPZ archive, or damaged", capsys)
    huge = whole.getvalue().replace(b"(2, 12), }      ", b"(9999999999,), }")
    assert huge != whole.getvalue()
    _replace_member(path, "w_fo.npy", huge)
    _refused(path, "w_fo", capsys)
    _replace_member(path, "w_fo.npy", bytes(MOST_BYTES))
    assert path.stat().st_size < MOST_BYTES // 10
    _refused(path, "larger than it may be", capsys)


def test_other_files_are_refused(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arrays = _arrays(path)
    np.savez(path, **(arrays | {"extra": np.zeros(3)}))
    _refused(path, "'extra' is unknown", capsys)
    arrays.pop("w_go")
    np.savez(path, **arrays)
    _refused(path, "'w_go' is missing", capsys)
    path.write_bytes(path.read_bytes()[:300])
    _refused(path, "is no NPZ archive, or damaged", capsys)
    path.write_bytes(b"")
    _refused(path, "is no NPZ archive, or damaged", capsys)
    _refused(path.parent, "is no plain file", capsys)
    _refused(path.with_name("none.npz"), "no such file", capsys)


def test_a_file_too_large_is_refused(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with path.open("ab") as stream:
        stream.truncate(MOST_BYTES + 1)
    _refused(path, "bytes (expected at most", capsys)


def test_every_bit_that_flips_is_noticed_or_does_no_harm(path: Path, good: Identification) -> None:
    whole = path.read_bytes()
    rng = np.random.default_rng(6)
    refused = 0
    for place in rng.integers(0, len(whole), 300):
        data = bytearray(whole)
        data[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        with contextlib.suppress(InputError):
            refused += 1
            found = load_identification(path)
            refused -= 1
            np.testing.assert_array_equal(found.w_fo, good.w_fo)
            np.testing.assert_array_equal(found.w_go, good.w_go)
    assert refused > 100


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("control.law=paper", "the law 'paper' has networks of its own"),
        ('control.gains.model="rbf"', "would be the whole model"),
        ("control.gains.grid_q=5", "control.gains.grid_q: is set by"),
        ("control.gains.w_fo=0.5", "control.gains.w_fo: is set by"),
        ("control.interconnection=frozen", "trained with 'desired'"),
    ],
)
def test_what_does_not_go_together_is_refused(
    setting: str, expected: str, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _refused(path, expected, capsys, setting)


def test_laws_without_networks_run_as_before(path: Path) -> None:
    for law in ("computed_torque", "oracle"):
        assert _simulate(path, f"control.law={law}") == 0


def _calibrated(**changed: float) -> Calibration:
    joints = [
        JointCalibration(name=name, armature=0.0, **(changed if name == "joint2" else {}))
        for name in ("joint1", "joint2")
    ]
    load = LinkLoad(
        joint="joint2",
        mass_kg=4.0,
        first_moment_kg_m=(0.0, 0.0, 0.6),
        inertia_kg_m2=(0.1233, 0.0, 0.1233, 0.0, 0.0, 0.01),
    )
    return Calibration(robot="arm2", link=(load,), joint=tuple(joints))


def test_the_calibration_has_to_be_the_one_of_the_training(good: Identification) -> None:
    opened = open_session(SCENARIO, ["control.law=dftc"])
    used = _calibrated(coulomb=0.1)
    named = dataclasses.replace(good, calibration=fingerprint(used))
    prepare(opened.scenario, opened.robot, used, named)
    prepare(opened.scenario, opened.robot, _calibrated(coulomb=0.1, coulomb_std=0.01), named)
    for other in (_calibrated(coulomb=0.2), None):
        with pytest.raises(InputError, match="train again after calibrating"):
            prepare(opened.scenario, opened.robot, other, named)


def test_the_path_is_relative_to_the_scenario(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = tmp_path / "own.toml"
    scenario.write_text(
        'name = "own"\nduration_s = 0.05\n[robot]\nname = "arm2"\n'
        '[control]\nidentification = "good.npz"\n'
    )
    monkeypatch.chdir("/")
    assert command(["simulate", str(scenario)]) == 0
