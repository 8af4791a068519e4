"""The directory of the user-space buses: where, whose, and one owner at a time."""

from __future__ import annotations

import fcntl
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from dftc_rt.bus.directory import BusDirectory, check_directory, resolve_directory, socket_path
from dftc_rt.errors import InputError


def test_option_before_environment_before_xdg_before_tmp() -> None:
    everything = {"DFTC_BUS_DIR": "/a", "XDG_RUNTIME_DIR": "/run/user/7"}
    assert resolve_directory("/opt", everything) == Path("/opt")
    assert resolve_directory(None, everything) == Path("/a")
    assert resolve_directory("", {"XDG_RUNTIME_DIR": "/run/user/7"}) == Path("/run/user/7/dftc")
    assert resolve_directory(None, {}) == Path(f"/tmp/dftc-{os.geteuid()}")


def test_a_new_directory_is_private(tmp_path: Path) -> None:
    claim = BusDirectory(tmp_path / "buses")
    assert (tmp_path / "buses").stat().st_mode & 0o777 == 0o700
    assert (tmp_path / "buses" / "owner.pid").read_text() == f"{os.getpid()}\n"
    claim.release()
    claim.release()
    assert list((tmp_path / "buses").iterdir()) == []


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o701])
def test_a_directory_open_to_others_is_refused(tmp_path: Path, mode: int) -> None:
    tmp_path.chmod(mode)
    with pytest.raises(InputError, match=f"mode {mode:04o}"):
        BusDirectory(tmp_path)


def test_what_is_no_directory_is_refused(tmp_path: Path) -> None:
    target = tmp_path / "target"
    target.mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(target)
    (tmp_path / "file").touch()
    for name in ("link", "file"):
        with pytest.raises(InputError, match="not a directory"):
            BusDirectory(tmp_path / name)
    with pytest.raises(InputError, match="No such file"):
        check_directory(tmp_path / "absent")
    with pytest.raises(InputError, match="parent"):
        BusDirectory(tmp_path / "absent" / "buses")


def test_somebody_elses_directory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = tmp_path / "buses"
    directory.mkdir(mode=0o700)
    owner = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    with pytest.raises(InputError, match=f"belongs to uid {owner}"):
        check_directory(directory)


def test_one_in_use_is_refused_with_its_owners_pid(tmp_path: Path) -> None:
    program = (
        "import sys; from pathlib import Path; from dftc_rt.bus.directory import BusDirectory\n"
        "claim = BusDirectory(Path(sys.argv[1])); print('ready', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path / "buses")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "ready\n"
        with pytest.raises(InputError, match=f"in use by process {owner.pid}"):
            BusDirectory(tmp_path / "buses")
        owner.kill()
    # A killed owner leaves its file behind, but no claim.
    BusDirectory(tmp_path / "buses").release()


def test_an_owner_that_leaves_while_the_next_one_comes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file that was opened is no longer the one in the directory: locking it claims nothing."""
    lock = fcntl.flock
    owner_file = tmp_path / "buses" / "owner.pid"
    calls: list[int] = []

    def leave_first(fd: int, operation: int) -> None:
        calls.append(fd)
        if len(calls) == 1:
            owner_file.unlink()
        lock(fd, operation)

    monkeypatch.setattr(fcntl, "flock", leave_first)
    claim = BusDirectory(tmp_path / "buses")
    with pytest.raises(InputError, match=f"in use by process {os.getpid()}"):
        BusDirectory(tmp_path / "buses")
    claim.release()


def test_stale_sockets_go_and_other_files_stay(tmp_path: Path) -> None:
    directory = tmp_path / "buses"
    directory.mkdir(mode=0o700)
    (directory / "notes").touch()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(directory / "can0"))
    claim = BusDirectory(directory)
    assert sorted(entry.name for entry in directory.iterdir()) == ["notes", "owner.pid"]
    claim.release()
    assert [entry.name for entry in directory.iterdir()] == ["notes"]


def test_a_directory_that_somebody_removed_is_released_all_the_same(tmp_path: Path) -> None:
    first = BusDirectory(tmp_path / "bus")
    shutil.rmtree(first.path)
    first.release()
    assert not first.path.exists()


def test_a_directory_that_is_anothers_by_now_is_left_to_him(tmp_path: Path) -> None:
    first = BusDirectory(tmp_path / "bus")
    shutil.rmtree(first.path)
    second = BusDirectory(tmp_path / "bus")
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(str(second.path / "can0"))
    first.release()
    assert {path.name for path in second.path.iterdir()} == {"can0", "owner.pid"}
    second.release()
    assert list(second.path.iterdir()) == []
    listener.close()


@pytest.mark.parametrize("name", ["", "..", "a/b", ".can0", "can 0", "owner.pid", "c\0"])
def test_names_that_are_no_bus_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="bus name"):
        socket_path(Path("/tmp"), name)


def test_a_path_too_long_for_a_socket_is_refused() -> None:
    assert socket_path(Path("/" + "d" * 101), "can0")
    with pytest.raises(InputError, match="too long"):
        socket_path(Path("/" + "d" * 102), "can0")
