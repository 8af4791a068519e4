"""``dftc control`` where nobody is at the other end: exit code 3, and what to start."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from dftc_rt.bus.directory import BusDirectory
from dftc_rt.cli import control
from dftc_rt.cli.main import run
from dftc_rt.errors import BusError
from hil.bus.unix import listen
from tests.integration.commands import dftc

pytestmark = pytest.mark.realtime

PANDA = "panda_shoulder_loss"


@pytest.fixture
def directory(tmp_path: Path) -> Iterator[Path]:
    made = BusDirectory(tmp_path / "bus")
    yield made.path
    made.release()


def lacks(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    assert run(["control", PANDA, *arguments]) == 3
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("dftc: ")
    assert err.count("\n") == 1
    return err


def test_no_rig(directory: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for place in (directory, directory / "none"):
        line = lacks(["--bus", "unix", "--bus-dir", str(place)], capfd)
        assert f"dftc rig {PANDA} --bus unix --bus-dir {place}" in line


def test_no_rig_at_the_default_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DFTC_BUS_DIR", str(tmp_path / "none"))
    assert "dftc rig" in lacks(["--bus", "unix"], capfd)


@pytest.mark.parametrize(
    ("profile", "kind"),
    [
        ("mit", "bitrate 1000000 restart-ms 100,"),
        ("moteus", "bitrate 1000000 dbitrate 5000000 fd on restart-ms 100,"),
    ],
)
def test_an_interface_that_is_down(
    profile: str, kind: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def down(name: str, interface: str, *, fd: bool, errors: bool) -> None:
        assert errors
        assert fd == (profile == "moteus")
        raise BusError(name, f"the interface {interface} is down")

    monkeypatch.setattr(control, "SocketCanSocket", down)
    options = ["--set", f"bus.profile={profile}", "--bus", "socketcan:can4,can5,can6"]
    line = lacks(options, capfd)
    assert "can4 is down" in line
    assert f"ip link set NAME up type can {kind} as root" in line


def test_drives_that_do_not_answer(directory: Path, tmp_path: Path) -> None:
    listeners = [listen(directory, f"can{i}") for i in range(3)]  # and nobody serves them
    done = dftc("control", PANDA, "--bus", "unix", "--bus-dir", directory, cwd=tmp_path)
    for listener in listeners:
        listener.close()
    assert done.returncode == 3, done.stderr
    assert "panda_joint1 (node 1 on can0): no answer to SDO" in done.stderr
    assert f"dftc rig {PANDA} --bus unix" in done.stderr
    assert "Traceback" not in done.stderr
