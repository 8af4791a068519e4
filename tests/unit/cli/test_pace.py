"""Timing ``pace`` and overloaded buses: what is refused, in one line, and what goes on."""

from __future__ import annotations

import pytest

from dftc_rt.bus.budget import bus_load
from dftc_rt.cli import session
from dftc_rt.cli.main import run
from dftc_rt.cli.processes.buses import choose
from dftc_rt.controller import bus_loads, read_budget_s
from dftc_rt.errors import InputError

PACE = "bus.timing=pace"
ONE_BUS = "robot.joints_per_bus=6"


@pytest.fixture(scope="module")
def paced() -> session.Session:
    return session.open_session("ur5_elbow_loss", [PACE])


def test_pace_is_for_the_user_space_bus_in_wall_time(paced: session.Session) -> None:
    assert choose(paced, "unix", lockstep=False).kind == "unix"
    assert choose(paced, None, lockstep=False).kind == "unix"  # even where there is vcan
    with pytest.raises(InputError, match=r"bus\.timing: 'pace' on inprocess"):
        choose(paced, "inprocess", lockstep=False)
    with pytest.raises(InputError, match=r"bus\.timing: 'pace' where no time passes"):
        choose(paced, "unix", lockstep=True)
    with pytest.raises(InputError, match=r"bus\.interface"):
        choose(paced, "ether", lockstep=False)


@pytest.mark.parametrize(
    "command", [["simulate"], ["hil", "--lockstep"], ["hil", "--bus", "inprocess"],
                ["rig", "--lockstep"]],
)  # fmt: skip
def test_elsewhere_it_is_one_line(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run([command[0], "ur5_elbow_loss", *command[1:], "--set", PACE]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    assert "bus.timing" in err


def test_an_overloaded_bus_is_refused_unless_it_is_allowed() -> None:
    with pytest.raises(InputError, match="6 joints at 1000 Hz need"):
        session.open_session("ur5_elbow_loss", [ONE_BUS])
    opened = session.open_session("ur5_elbow_loss", [ONE_BUS, "bus.overload=allow"])
    (load,) = bus_loads(opened.scenario, opened.robot)
    assert not load.fits
    assert 0.0 <= read_budget_s(opened.scenario, [load]) < 1e-3


def test_the_read_budget_of_a_bus_full_of_commands_is_no_less_than_nothing() -> None:
    # 30 commands of 95 bits at worst take more than twice a period of 1000 bits.
    opened = session.open_session("ur5_elbow_loss", ["bus.overload=allow"])
    (load, _) = bus_loads(opened.scenario, opened.robot)
    full = bus_load("can0", 30, rate_hz=load.rate_hz, bitrate=load.bitrate)
    assert read_budget_s(opened.scenario, [full]) == 0.0
