"""Laws of one's own: found by name, made from what they need, kept within the drive's limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dftc_rt.cli.main import run as dftc
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.control import laws, signals
from dftc_rt.control.interface import NONFINITE_INPUT, NONFINITE_LAW
from dftc_rt.errors import InputError, LawError
from dftc_rt.rt.supervisor import State

N = 2

SOURCE = """
import numpy as np
from dftc_rt.control.plugin import TorqueLaw

class Constant(TorqueLaw):
    def torque(self, q, v, qd, vd, ad):
        return self.given.gain("nm", 1.0)

class Local(TorqueLaw):
    uses_local_terms = True
    def __init__(self, given):
        super().__init__(given)
        self.lam, self.k = given.gain("lam", 1.0), given.gain("k", 1.0)
    def torque(self, q, v, qd, vd, ad):
        kp, kd = self.lam * self.k, self.lam + self.k
        return self.inertia * (ad - kd * (v - vd) - kp * (q - qd)) + self.bias

class Meddler(TorqueLaw):
    def update(self, rec, inertia, bias, load=None):
        rec[:5] = 7.0
        rec[7] = 0.5
        return 0

class Raises(TorqueLaw):
    def torque(self, q, v, qd, vd, ad):
        raise FloatingPointError("as it happens")

class Refuses(TorqueLaw):
    def __init__(self, given):
        raise RuntimeError("not today")

class Bare:
    def __init__(self, given):
        pass

something = 3
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    # a name of its own for every test: Python keeps what it has imported
    (tmp_path / f"{module(tmp_path)}.py").write_text(SOURCE)
    (tmp_path / f"broken_{module(tmp_path)}.py").write_text("import not_there_at_all\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def module(folder: Path) -> str:
    return "laws_" + "".join(c if c.isalnum() else "_" for c in folder.name)


def build(name: str, **gains: Any) -> Any:
    return laws.build(
        name, N, 0.001, np.array([10.0, 20.0]), np.array([0.5, 0.0]), np.ones(N), gains, True,
        np.full(N, -3.0), np.full(N, 3.0), np.full(N, 3.0),
    )  # fmt: skip


def record() -> Any:
    rec = np.zeros((len(signals.NAMES), N))
    rec[signals.Q] = 0.1
    return rec


def cycle(law: Any, rec: Any) -> int:
    return int(law.update(rec, np.ones(N), np.zeros(N)))


def test_torque_is_rounded_to_the_steps_of_the_drive_and_held_to_its_limit(here: Path) -> None:
    law, rec = build(f"{module(here)}:Constant", nm=[0.7, 99.0]), record()
    law.start(np.zeros(N), np.zeros(N))
    assert cycle(law, rec) == 0
    assert rec[signals.TAU_CMD].tolist() == [0.5, 20.0]
    assert rec[signals.TAU_LAW].tolist() == [0.7, 99.0]
    assert np.isnan(rec[signals.RHO_HAT]).all()


def test_what_was_measured_is_not_for_the_law_to_change(here: Path) -> None:
    law, rec = build(f"{module(here)}:Meddler"), record()
    before = rec[: signals.AD + 1].copy()
    assert cycle(law, rec) == 0
    assert (rec[: signals.AD + 1] == before).all()
    assert (rec[signals.RHO_HAT] == 0.5).all()


def test_nan_in_and_nan_out_are_told_and_nothing_is_sent(here: Path) -> None:
    law, rec = build(f"{module(here)}:Local"), record()
    rec[signals.V, 1] = np.nan
    assert cycle(law, rec) == NONFINITE_INPUT
    assert not rec[signals.TAU_CMD].any()
    rec = record()
    assert int(law.update(rec, np.array([1.0, np.inf]), np.zeros(N))) == NONFINITE_LAW
    assert not rec[signals.TAU_CMD].any()
    assert np.isnan(rec[signals.S]).tolist() == [False, True]


def test_what_a_law_raises_is_one_line_with_its_place(here: Path) -> None:
    law = build(f"{module(here)}:Raises")
    with pytest.raises(LawError) as caught:
        cycle(law, record())
    line = str(caught.value)
    assert line.startswith(f"law {module(here)}:Raises: FloatingPointError: as it happens (")
    assert line.endswith(f"{module(here)}.py:26)")
    assert "\n" not in line


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("nowhere_at_all:Law", r"control\.law: no module 'nowhere_at_all' \(expected module:Class"),
        ("{}:Missing", r"has no class 'Missing'"),
        ("{}:something", r"has no class 'something'"),
        ("{}:", r"has no class ''"),
        ("{}:Bare", r"has no 'start'"),
        ("nonsense", r"control\.law: 'nonsense' .*module:Class"),
    ],
)
def test_what_is_no_law_is_refused(here: Path, name: str, line: str) -> None:
    with pytest.raises(InputError, match=line):
        build(name.format(module(here)))


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("{}:Refuses", "RuntimeError: not today"),
        ("broken_{}:Law", "ModuleNotFoundError: No module named 'not_there_at_all'"),
    ],
)
def test_errors_of_its_own_are_named_as_such(here: Path, name: str, line: str) -> None:
    with pytest.raises(LawError, match=line):
        build(name.format(module(here)))


def test_a_gain_that_is_no_number_is_one_line(here: Path) -> None:
    law = build(f"{module(here)}:Constant", nm="much")
    with pytest.raises(
        InputError, match=r"control\.gains\.nm: 'much' \(expected a finite number, or 2"
    ):
        cycle(law, record())


def test_a_robot_runs_on_it(here: Path) -> None:
    settings = [f"control.law={module(here)}:Local", "duration_s=1.0", "fault=[]"]
    run, outcome = run_simulation(open_session("panda_shoulder_loss", settings))
    assert outcome.end_state == "done"
    moving = run.cycle["state"] == State.RUN
    assert moving.sum() > 900
    assert np.abs(run.cycle["q"] - run.cycle["qd"])[moving].max() < 2e-3


def test_a_run_whose_law_raises_ends_in_one_line(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    law = f"control.law={module(here)}:Raises"
    assert dftc(["simulate", "panda_shoulder_loss", "--set", law]) == 1
    found = capsys.readouterr().err
    assert f"law {module(here)}:Raises: FloatingPointError: as it happens" in found
    assert "Traceback" not in found
