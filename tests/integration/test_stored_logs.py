"""Logs that are kept: what the control code made of them then, it makes of them now.

On the processor that recorded them the replay is equal to the last bit. Others may differ in
the last bits of a sine or an exponential, which NumPy and Numba compute in other ways there; a
command is then rounded to the next step of its drive now and then, and a verdict comes a cycle
earlier or later at most. So the comparison is to a tolerance far above such differences, and
far below what any change of the control code makes.
"""

from __future__ import annotations

import lzma
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.cli.main import run as command
from dftc_rt.control.dftc import Dftc
from dftc_rt.control.signals import ANOMALY
from dftc_rt.drives.scale import TORQUE_PER_COUNT
from dftc_rt.log.ending import ending_of
from dftc_rt.log.reader import read
from dftc_rt.log.run import Run
from dftc_rt.replay.loop import Replayed, replay
from dftc_rt.replay.stored import Stored, controller_of

LOGS = sorted((Path(__file__).parents[1] / "logs").glob("*.mcap.xz"))
SMOOTH = ("qd", "vd", "ad", "tau_law", "rho_hat", "rho_std", "s", "residual")
CLOSE = 1e-6  # of the largest value: rounding grows by four orders, 2e-16 to 1e-12 at most
STEPS = 0.01  # of all commands may be rounded to the step beside

F64 = NDArray[np.float64]


def unpacked(path: Path, folder: Path) -> Path:
    log = folder / path.stem
    log.write_bytes(lzma.decompress(path.read_bytes()))
    return log


def differences(run: Run, stored: Stored, replayed: Replayed) -> list[str]:
    """What is more than rounding."""
    found = []
    if len(replayed.cycle["t"]) != len(run.cycle["t"]):
        found.append("its length")
        return found
    for name in SMOOTH:
        ours, theirs = replayed.cycle[name], run.cycle[name]
        if not np.array_equal(np.isnan(ours), np.isnan(theirs)):
            found.append(f"{name}: no number")
        elif np.nanmax(np.abs(ours - theirs), initial=0) > CLOSE * np.nanmax(np.abs(theirs)):
            found.append(name)
    step = 2.0 * np.abs(stored.parts.scales.values[TORQUE_PER_COUNT])  # MIT counts half steps
    off = np.abs(replayed.cycle["tau_cmd"] - run.cycle["tau_cmd"])
    if np.any(off > 1.01 * step) or np.mean(off > 0.01 * step) > STEPS:
        found.append("tau_cmd")
    for name in ("verdict", "observable", "state"):
        ours, theirs = replayed.cycle[name], run.cycle[name]
        later, earlier = np.roll(theirs, 1, axis=0), np.roll(theirs, -1, axis=0)
        if not np.all((ours == theirs) | (ours == later) | (ours == earlier)):
            found.append(name)
    ending = ending_of(run.events)
    assert ending is not None
    if (replayed.outcome.end_state, replayed.outcome.reason) != (ending.end_state, ending.reason):
        found.append("the end")
    return found


def test_there_are_logs() -> None:
    assert len(LOGS) == 3
    assert sum(path.stat().st_size for path in LOGS) < 800_000


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.name.partition(".")[0])
def test_a_kept_log_is_replayed(path: Path, tmp_path: Path) -> None:
    run = read(unpacked(path, tmp_path))
    stored = controller_of(run)
    replayed = replay(stored, run)
    assert differences(run, stored, replayed) == []
    assert replayed.ended


@pytest.mark.parametrize(
    ("name", "setting"),
    [
        (name, setting)
        for name in ("arm2_real_time", "panda_calibrated", "panda_safe_stop")
        for setting in ("threshold_anomaly", "walk", "lam", "torque_lag_s")
        if (name, setting) != ("panda_safe_stop", "threshold_anomaly")  # it stops before
    ],
)
def test_a_changed_setting_is_found(name: str, setting: str, tmp_path: Path) -> None:
    """Any of them by a fifth: the tolerance hides no such change."""
    run = read(unpacked(LOGS[0].with_name(f"{name}.mcap.xz"), tmp_path))
    stored = controller_of(run)
    law = stored.parts.law
    assert isinstance(law, Dftc)
    value = 1.2 * law.storage.parameters[setting]
    changed = controller_of(run, [f"control.gains.{setting}={value.tolist()}"])
    assert differences(run, changed, replay(changed, run)) != []


def test_what_the_kept_logs_hold(tmp_path: Path) -> None:
    runs = {path.name.partition(".")[0]: read(unpacked(path, tmp_path)) for path in LOGS}
    assert runs["arm2_real_time"].cycle["age"].max() > 0  # answers that did not come
    assert runs["arm2_real_time"].cycle["lateness"].max() > 0
    calibrated = runs["panda_calibrated"].cycle["verdict"]
    assert {1.0, ANOMALY} <= set(np.unique(calibrated))
    assert "calibration.toml" in runs["panda_calibrated"].attachments
    stopped = ending_of(runs["panda_safe_stop"].events)
    assert stopped is not None
    assert stopped.end_state == "safe stop"


def test_the_command_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Here or on another processor: 0 and equal, or 1 and by how much."""
    log = unpacked(LOGS[0], tmp_path)
    code = command(["replay", str(log)])
    out = capsys.readouterr().out
    assert code == (0 if "equal to the last bit" in out else 1)
    assert code == 0 or "First difference: cycle" in out
