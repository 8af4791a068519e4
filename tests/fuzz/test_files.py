"""Bad files of every kind: one clear line, or a run in order; no traceback, no hang.

What is drawn is the same in every run. More of it: ``python -m tests.benchmarks fuzz``.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from dftc_rt.cli.main import run
from dftc_rt.errors import InputError
from tests.fuzz import files
from tests.fuzz.damage import altered
from tests.fuzz.files import Kind, toml_bytes, write

KINDS = files.every_kind()


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_it_is_taken_or_refused_in_one_line(kind: Kind) -> None:
    found = []

    @settings(
        max_examples=60, derandomize=True, deadline=None, database=None,
        phases=[Phase.explicit, Phase.generate], suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(kind.content)
    def survives(content: bytes) -> None:
        found.append(files.survive(kind, content))

    survives()
    assert "refused" in found


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_what_is_whole_is_taken(kind: Kind) -> None:
    assert files.survive(kind, kind.whole()) == "accepted"


def _scenario(*steps: str | int, value: object) -> bytes:
    node = table = files.copy_of(files.scenario_table())
    for step in steps[:-1]:
        node = node[step]
    node[steps[-1]] = value
    return toml_bytes(table)


def _robot(key: str, value: object) -> bytes:
    table = files.copy_of(files.robot_table())
    (table["joint"][0] if key in table["joint"][0] else table)[key] = value
    return toml_bytes(table)


def _calibration(key: str, value: object) -> bytes:
    table = files.copy_of(files.calibration_table())
    table["joint"][1]["gains"][key] = value
    return toml_bytes(table)


@pytest.mark.parametrize(
    ("take", "content", "says"),
    [
        # Each of these was a traceback, or was taken, when it was found.
        (files.try_scenario, _scenario("rig", "drive", "watchdog_s", value=1e300),
         "rig.drive.watchdog_s: found 1e+300 (expected a number <= 3600.0)"),
        (files.try_scenario, _scenario("reference", "blend_s", value=1e-300),
         "reference.blend_s: found 1e-300 (expected 0, or 0.0001 or more)"),
        (files.try_scenario, _scenario("control", "gains", "lam", value=1e300),
         "control.gains.lam: 1e+300 (expected 0 to 1e+15)"),
        (files.try_scenario, _scenario("control", "gains", "k", value=[1.0, 2**70]),
         "control.gains.k: 1180591620717411303424 (expected 0 to 1e+15)"),
        (files.try_scenario, _scenario("reference", "amplitude_rad", value=1e300),
         "joint1 would be at"),
        (files.try_scenario, _scenario("executor", "rate_hz", value=5.0),
         "executor.rate_hz: found 5.0 (expected a number >= 10.0)"),
        (files.try_scenario, _scenario("bus", "x\0\n\x1b[31m", value=1),
         r"bus.x\x00\n\x1b[31m: unknown key"),
        (files.try_scenario, _scenario("control", "gains", "lamb", value=1.0),
         "control.gains.lamb: unknown key (expected 'lam'"),
        (files.try_scenario,
         _scenario("fault", 0, value={"kind": "sensor_bias", "joint": "joint1", "bias_rad": 1e300}),
         "fault[0].bias_rad: found 1e+300"),
        (files.try_robot, _robot("gear", 5e-324), "gear of joint 'shoulder' is 4.94066e-324"),
        (files.try_robot, _robot("counts_per_rev", 2**63 - 1), "counts_per_rev of joint"),
        (files.try_robot, _robot("rated_torque_nm", 5e-324), "rated_torque_nm of joint 'shoulder'"),
        (files.try_robot, _robot("velocity_limit_rad_s", 5e-324), "velocity_limit_rad_s of joint"),
        (files.try_robot, _robot("delay_cycles", 2**31), "delay_cycles: found 2147483648"),
        (files.try_robot, _robot("gravity_m_s2", [0.0, 1e300, 0.0]), "gravity_m_s2: found 1e+300"),
        (files.try_robot, _robot("gains", {"lam": -1.0}), "robot 'two': gains.lam: -1.0"),
        (files.with_file("calibration", "c.toml"), _calibration("floor_nm", -1.0),
         "c.toml: joint[1].gains.floor_nm: -1.0 (expected 0 to 1e+15)"),
        (files.try_motion, b"t,q_1,q_2\n0,0.5,0.3\n1e-320,0.5,0.3\n", "two times 9.99989e-321"),
        (files.try_motion, b"t,q_1,q_2\n0,0.5,1e300\n1,0.5,0.3\n", "found 1e+300"),
        (files.try_urdf, files.LAUGHS, "no XML"),
        (files.try_urdf, files.OUTSIDE, "no XML"),
    ],
)  # fmt: skip
def test_what_was_found(take: object, content: bytes, says: str) -> None:
    kind = Kind("found", None, take, bytes)  # type: ignore[arg-type]
    with pytest.raises(InputError) as caught:
        kind.take(content)
    assert says in str(caught.value)
    assert files.survive(kind, content) == "refused"


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", "s.toml"], ["hil", "s.toml"], ["bus", "budget", "s.toml"],
        ["analyze", "bad.mcap"], ["report", "bad.mcap", "-o", "r.html"],
        ["export", "bad.mcap", "-o", "x.npz"], ["recover", "bad.mcap", "-o", "w.mcap"],
        ["replay", "bad.mcap"],
    ],
    ids=lambda arguments: arguments[0],
)  # fmt: skip
def test_the_command_line_says_it_in_one_line(
    arguments: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "s.toml", _scenario("rig", "drive", "watchdog_s", value=1e300))
    write(tmp_path / "bad.mcap", files.short_log()[:40])
    assert run(arguments) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("dftc: ")
    assert err.count("\n") == 1


def test_what_is_altered_differs() -> None:
    table = files.scenario_table()
    changed = []

    @settings(max_examples=50, derandomize=True, database=None)
    @given(altered(table))
    def look(found: dict[str, object]) -> None:
        changed.append(toml_bytes(found) != toml_bytes(table))

    look()
    assert sum(changed) > 40
