"""``dftc bus``: tables, JSON, refusals."""

from __future__ import annotations

import errno
import json
import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from dftc_rt.bus import vcan_links
from dftc_rt.cli import bus_links
from dftc_rt.cli.main import run
from dftc_rt.errors import EnvironmentLacksError

Lines = pytest.CaptureFixture[str]
PANDA = "panda_shoulder_loss"
BARE = """name = "bare"
[robot]
urdf = "ur_description/urdf/ur5_robot.urdf"
"""


def answer(capfd: Lines, *arguments: str, code: int = 0) -> tuple[Any, str]:
    """Run a command; return what it printed as JSON, and stderr."""
    assert run([*arguments, "--json"]) == code
    out, err = capfd.readouterr()
    assert out.count("\n") == 1
    return json.loads(out), err


def test_budget_of_a_robot(capfd: Lines) -> None:
    found, err = answer(capfd, "bus", "budget", PANDA)
    assert err == ""
    assert (found["robot"], found["fits"], found["buses_needed"]) == ("panda", True, 3)
    assert found["read_budget_us"] == pytest.approx(605)
    names = [(bus["name"], len(bus["joints"])) for bus in found["buses"]]
    assert names == [("can0", 3), ("can1", 2), ("can2", 2)]
    first = found["buses"][0]
    assert first["worst"] == pytest.approx(0.8898)
    assert first["worst_bits"] == pytest.approx(889.8)
    assert first["period_bits"] == 1000
    frames = {frame["name"]: frame for frame in first["frames"]}
    answers = frames["TPDO1 position, velocity"]
    assert answers["identifiers"] == [0x181, 0x182, 0x183]
    assert answers["latencies_us"] == pytest.approx([470, 605, 740])
    assert answers["latency_us"] == pytest.approx(740)
    assert frames["RPDO1 command"]["latency_us"] == pytest.approx(420)
    assert frames["EMCY"]["latency_us"] is None
    assert frames["EMCY"]["latency_emcy_us"] > 0


@pytest.mark.parametrize(
    ("settings", "joints"),
    [
        ([], [3, 3]),
        (["executor.rate_hz=500"], [6]),
        (["executor.rate_hz=2000"], [1] * 6),
        (["bus.profile=mit", "executor.rate_hz=800"], [3, 3]),
        (["bus.profile=moteus"], [3, 3]),  # of 4 that a bus could have
        (["bus.profile=moteus", "executor.rate_hz=600"], [6]),
        (["robot.joints_per_bus=2"], [2, 2, 2]),
    ],
)
def test_a_bare_urdf_has_as_few_buses_as_will_do(
    settings: list[str], joints: list[int], capfd: Lines, tmp_path: Path
) -> None:
    scenario = tmp_path / "bare.toml"
    scenario.write_text(BARE)
    options = [word for each in settings for word in ("--set", each)]
    found, _ = answer(capfd, "bus", "budget", str(scenario), *options)
    assert [len(bus["joints"]) for bus in found["buses"]] == joints
    assert found["fits"]
    assert found["buses_needed"] <= len(joints)


def test_a_bare_urdf_of_which_no_joint_fits_a_bus_is_refused(capfd: Lines, tmp_path: Path) -> None:
    scenario = tmp_path / "bare.toml"
    scenario.write_text(BARE)
    found, err = answer(
        capfd, "bus", "budget", str(scenario), "--set", "executor.rate_hz=5000", code=2
    )
    assert [len(bus["joints"]) for bus in found["buses"]] == [1] * 6
    assert "not even one joint" in err


def test_latencies_scale_with_the_bit_rate(capfd: Lines) -> None:
    arguments = ["bus", "budget", PANDA, "--set", "bus.bitrate=500000"]
    found, _ = answer(capfd, *arguments, "--set", "executor.rate_hz=400")
    (sync,) = (f for f in found["buses"][0]["frames"] if f["role"] == "sync")
    assert sync["latency_us"] == pytest.approx(400)


def test_an_overloaded_bus_is_shown_then_refused(capfd: Lines) -> None:
    arguments = ["bus", "budget", PANDA, "--set", "executor.rate_hz=1500"]
    assert run(arguments) == 2
    out, err = capfd.readouterr()
    assert "can0" in out
    assert "worst case" in out
    # 65 + 75 + 3 · 230, and 17 (TPDO2), 18 (SDO), 5 (heartbeats, EMCY): 870 bits of 667.
    assert err == (
        "dftc: bus can0: 3 joints at 1500 Hz need 130% of the period in the worst case "
        "(expected at most 90%: 7 buses would do for 7 joints)\n"
    )
    found, err = answer(capfd, *arguments, code=2)
    assert (found["fits"], found["buses_needed"]) == (False, 7)
    assert err.count("\n") == 1


def test_a_full_bus_has_no_bound_and_not_even_one_joint_fits(capfd: Lines) -> None:
    arguments = ["bus", "budget", PANDA, "--set", "executor.rate_hz=5000"]
    found, err = answer(capfd, *arguments, code=2)
    assert found["buses_needed"] is None
    assert "not even one joint" in err
    last = found["buses"][0]["frames"][-2]
    assert last["name"] == "controller heartbeat"
    assert last["latency_us"] is None
    assert run(arguments) == 2
    assert "none" in capfd.readouterr().out


def test_the_table_fits_a_narrow_terminal(capfd: Lines, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert run(["bus", "budget", PANDA]) == 0
    out, _ = capfd.readouterr()
    assert "…" not in out
    for text in ("0x201–0x203", "panda_joint3", "89.0%", "605 µs"):
        assert text in out


def test_budget_of_mit_drives(capfd: Lines) -> None:
    """A command and an answer take 135 bits each, one after the other."""
    arguments = ("bus", "budget", PANDA, "--set", "bus.profile=mit")
    found, _ = answer(capfd, *arguments)
    assert found["buses"][0]["worst"] == pytest.approx(0.81)
    command, back = found["buses"][0]["frames"]
    assert command["identifiers"] == [1, 2, 3]
    assert command["latencies_us"] == pytest.approx([135, 405, 675])
    assert back["identifiers"] == [0]
    assert back["latencies_us"] == pytest.approx([810])
    assert (back["latency_emcy_us"], back["latencies_emcy_us"]) == (None, [])
    assert run([*arguments]) == 0
    assert "that leaves 190 µs to compute" in capfd.readouterr().out
    found, err = answer(capfd, *arguments, "--set", "executor.rate_hz=1200", code=2)
    assert "3 buses would do" not in err
    assert found["buses"][0]["frames"][1]["latency_us"] == pytest.approx(810)  # 833 would do
    found, _ = answer(capfd, *arguments, "--set", "executor.rate_hz=1300", code=2)
    assert found["buses"][0]["frames"][1]["latency_us"] is None


def test_budget_of_moteus_drives(capfd: Lines) -> None:
    """All commands first, 112.6 µs each, then the answers in order of node id, 95.6 µs each."""
    options = ("--set", "bus.profile=moteus", "--set", "robot.joints_per_bus=4")
    found, _ = answer(capfd, "bus", "budget", PANDA, *options)
    command, back = found["buses"][0]["frames"]
    assert command["identifiers"] == [0x8001, 0x8002, 0x8003, 0x8004]
    assert command["latencies_us"] == pytest.approx([112.6, 225.2, 337.8, 450.4])
    assert back["identifiers"] == [0x100, 0x200, 0x300, 0x400]
    assert back["latencies_us"] == pytest.approx([546.0, 641.6, 737.2, 832.8])
    assert back["latency_us"] == pytest.approx(832.8)


def test_budget_of_can_fd_buses_wired_anew(capfd: Lines) -> None:
    def ask(*settings: str, code: int = 0) -> Any:
        options = [word for each in settings for word in ("--set", each)]
        words = ("bus", "budget", PANDA, "--set", "bus.profile=moteus", *options)
        return answer(capfd, *words, code=code)[0]

    found = ask("robot.joints_per_bus=4")
    assert [len(bus["joints"]) for bus in found["buses"]] == [4, 3]
    assert found["buses"][0]["worst"] == pytest.approx(0.8328)
    assert found["buses"][0]["busiest_bits"] == 833
    assert found["buses_needed"] == 2
    found = ask("robot.joints_per_bus=7", "executor.rate_hz=500")
    assert [bus["worst"] for bus in found["buses"]] == [pytest.approx(7 * 208.2e-6 * 500)]
    assert ask("robot.joints_per_bus=7", code=2)["fits"] is False
    assert ask("bus.data_bitrate=2000000", code=2)["buses_needed"] == 4


@pytest.mark.parametrize("command", ["budget", "up", "down"])
def test_a_scenario_that_is_not_there(command: str, capfd: Lines) -> None:
    assert run(["bus", command, "nowhere"]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert PANDA in err


@pytest.mark.parametrize(
    ("given", "links"),
    [
        (PANDA, ["vcan0", "vcan1", "vcan2"]),
        ("can0,can3", ["vcan0", "vcan3"]),
        ("vcan0,can0,can1", ["vcan0", "vcan1"]),
    ],
)
def test_links_of_a_scenario_and_of_a_list(
    given: str, links: list[str], capfd: Lines, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bus_links, "bring_up", lambda names, fd: dict.fromkeys(names, "made"))
    assert run(["bus", "up", given]) == 0
    assert capfd.readouterr().out == "".join(f"{link}: made\n" for link in links)
    monkeypatch.setattr(bus_links, "take_down", lambda names: dict.fromkeys(names, "removed"))
    assert run(["bus", "down", given]) == 0
    assert capfd.readouterr().out == "".join(f"{link}: removed\n" for link in links)


def test_up_without_socketcan_says_what_to_do(
    capfd: Lines, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown_family(family: int, *_: int) -> None:
        assert family == socket.AF_CAN
        raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    kernel = SimpleNamespace(
        socket=unknown_family, AF_CAN=socket.AF_CAN, SOCK_RAW=socket.SOCK_RAW, CAN_RAW=1
    )
    monkeypatch.setattr(vcan_links, "socket", kernel)
    assert run(["bus", "up", "can0"]) == EnvironmentLacksError.exit_code == 3
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    for words in ("no SocketCAN", "modprobe", "root", "--bus unix"):
        assert words in err


def test_down_where_nothing_is(capfd: Lines) -> None:
    assert run(["bus", "down", "can97,can98"]) == 0
    assert capfd.readouterr().out == "vcan97: was not there\nvcan98: was not there\n"


def test_dbc_files_one_a_bus(capfd: Lines, tmp_path: Path) -> None:
    target = tmp_path / "panda.dbc"
    assert run(["bus", "dbc", PANDA, "-o", str(target)]) == 0
    out, _ = capfd.readouterr()
    paths = [tmp_path / f"panda-can{k}.dbc" for k in range(3)]
    assert out == "".join(f"{path}\n" for path in paths)
    assert sorted(tmp_path.iterdir()) == paths
    text = paths[2].read_text("cp1252")
    assert "panda_joint7_TPDO1" in text
    assert "panda_joint5" not in text


def test_dbc_of_one_bus_is_the_file_named(capfd: Lines, tmp_path: Path) -> None:
    target = tmp_path / "arm.dbc"
    assert run(["bus", "dbc", "paper_example2", "-o", str(target)]) == 0
    assert capfd.readouterr().out == f"{target}\n"
    assert list(tmp_path.iterdir()) == [target]


def test_dbc_replaces_nothing_unasked(capfd: Lines, tmp_path: Path) -> None:
    there = tmp_path / "panda-can1.dbc"
    there.write_text("mine")
    arguments = ["bus", "dbc", PANDA, "-o", str(tmp_path / "panda.dbc")]
    assert run(arguments) == 2
    assert "panda-can1.dbc: is there already" in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == [there]
    assert there.read_text() == "mine"
    assert run([*arguments, "--force"]) == 0
    assert there.read_text("cp1252").startswith("VERSION")


def test_dbc_where_nothing_can_be_written(capfd: Lines, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert run(["bus", "dbc", PANDA, "-o", str(tmp_path / "file" / "x.dbc")]) == 2
    assert capfd.readouterr().err.count("\n") == 1


def test_dbc_without_cantools(
    capfd: Lines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "cantools", None)
    assert run(["bus", "dbc", PANDA, "-o", str(tmp_path / "x.dbc")]) == 3
    assert "dftc_rt[dbc]" in capfd.readouterr().err
