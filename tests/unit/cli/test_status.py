"""The live status: what is shown of a run, from shared memory alone."""

from __future__ import annotations

import io
from collections.abc import Iterator

import numpy as np
import pytest
from rich.console import Console

from dftc_rt.cli import status as status_module
from dftc_rt.cli.processes.roles import Rings
from dftc_rt.cli.session import Session, open_session
from dftc_rt.cli.status import Status
from dftc_rt.control import signals
from dftc_rt.rt.supervisor import State
from hil.bus.statistics import EXACT


@pytest.fixture(scope="module")
def opened() -> Session:
    return open_session("panda_shoulder_loss")


@pytest.fixture
def rings(opened: Session) -> Iterator[Rings]:
    made = Rings.create(opened)
    yield made
    for ring in (made.cycle, made.rig, *made.events):
        ring.close()


def put(rings: Rings, opened: Session, cycles: int = 1) -> None:
    """Records at 12.5 s in which the second joint has lost half of its torque."""
    record = np.zeros(opened.cycle.size)
    record[:7] = (12.5, 48e-6, 7e-5, 3e-4, float(State.DEGRADED), 3.0, 0.0)
    rows = record[7:].reshape(len(signals.NAMES), 7)
    rows[signals.RHO_HAT] = 1.0
    rows[signals.RHO_HAT, 1] = 0.5
    rows[signals.RHO_HAT, 4] = np.nan
    rows[signals.VERDICT, 1] = signals.ACTUATOR_LOSS
    rows[signals.VERDICT, 2] = signals.ANOMALY
    rows[signals.Q, 1] = 0.00312
    rows[signals.TAU_CMD, 1] = 0.95 * opened.parts.torque_limit[1]
    for _ in range(cycles):
        rings.cycle.slot()[:] = record
        rings.cycle.commit()


def printed(what: object, width: int = 80) -> str:
    console = Console(width=width, file=io.StringIO(), record=True, color_system=None)
    console.print(what)
    return console.export_text()


def test_rate_and_load_are_those_since_the_last_look(opened: Session, rings: Rings) -> None:
    status = Status(opened)
    assert status.look(rings, 10.0) is None  # nothing has been recorded
    put(rings, opened)
    first = status.look(rings, 10.0)
    assert first is not None
    assert first.rate_hz is None
    put(rings, opened, 250)
    rings.traffic[:, EXACT] = (175_000, 120_000, 0)  # bits, at 1 Mbit/s
    second = status.look(rings, 10.25)
    assert second is not None
    assert second.rate_hz == pytest.approx(1000.0)
    assert second.loads == pytest.approx({"can0": 0.7, "can1": 0.48, "can2": 0.0})


def test_the_table_has_a_row_a_joint_in_80_columns(opened: Session, rings: Rings) -> None:
    status = Status(opened)
    put(rings, opened)
    status.look(rings, 10.0)
    put(rings, opened, 200)
    rings.traffic[:, EXACT] = (140_000, 96_000, 96_000)
    shown = status.look(rings, 10.2)
    assert shown is not None
    lines = printed(status.table(shown)).splitlines()
    facts = "t 12.5 s degraded 1000 cycles/s lateness 48 us overruns 3"
    assert " ".join(lines[0].split()) == facts
    assert lines[1] == "bus load: can0 70 % can1 48 % can2 48 %"
    rows = {line.split()[0]: line for line in lines if line.startswith("panda")}
    assert set(rows) == set(opened.robot.joints)  # none cut short
    torque = 0.95 * opened.parts.torque_limit[1]
    assert rows["panda_joint2"].split() == [
        "panda_joint2", "3.12", "0.50", "████····", "actuator", "loss", f"{torque:.1f}", "95",
        "████████",
    ]  # fmt: skip
    assert "anomaly not ye…" in rows["panda_joint3"]
    assert " –  " in rows["panda_joint5"]
    assert max(map(len, lines)) <= 80


def test_the_line_has_the_same_and_who_is_worst(opened: Session, rings: Rings) -> None:
    status = Status(opened)
    put(rings, opened)
    shown = status.look(rings, 10.0)
    assert shown is not None
    line = status.line(shown)
    assert "\n" not in line
    assert line.startswith("t   12.5 s  degraded  lateness 48 us  overruns 3  can0 74 % can1 54 %")
    assert "can2 54 % planned" in line  # nobody has counted
    assert "worst error 3.12 mrad (panda_joint2)  panda_joint2 actuator loss (rho 0.50)" in line


def test_plain_lines_come_seldom_and_quiet_is_quiet(
    opened: Session, rings: Rings, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    now = [100.0]
    monkeypatch.setattr(status_module.time, "monotonic", lambda: now[0])
    put(rings, opened)
    with Status(opened) as status, Status(opened, quiet=True) as silent:
        for _ in range(11):
            status.watch(rings)
            silent.watch(rings)
            now[0] += 1.0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3  # at 0, 5 and 10 s
    assert "\x1b" not in "".join(lines)
