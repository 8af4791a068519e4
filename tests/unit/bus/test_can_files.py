"""Exported frames, read back by python-can's own readers."""

from __future__ import annotations

import re
from pathlib import Path

import can
import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.bus.can_files import SUFFIXES, write_can_file
from dftc_rt.bus.frame import BRS, EFF_FLAG, ESI, FDF, RTR_FLAG
from dftc_rt.bus.frame_record import record_dtype
from dftc_rt.errors import InputError

BUSES = ("can0", "arm")
EPOCH = 1436509052.25
WHOLE = ("candump", "asc", "blf")  # formats that hold all there is


def classical(count: int = 300) -> NDArray[np.void]:
    rng = np.random.default_rng(2)
    found = np.zeros(count, record_dtype(8))
    found["t"] = np.arange(count) * 1e-3
    wide = rng.integers(0, 2, count) == 1
    found["id"] = np.where(
        wide, EFF_FLAG | rng.integers(0, 1 << 29, count), rng.integers(0, 1 << 11, count)
    )
    found["bus"] = rng.integers(0, 2, count)
    found["tx"] = rng.integers(0, 2, count)
    found["length"] = rng.integers(0, 9, count)
    found["data"] = rng.integers(0, 256, (count, 8))
    found["data"][np.arange(8) >= found["length"][:, None]] = 0
    return found


def fd() -> NDArray[np.void]:
    """Return FD frames with every combination of flags, and a classical one among them."""
    found = np.zeros(5, record_dtype(64))
    found["t"] = np.arange(5) * 1e-3
    found["id"] = [0x8001 | EFF_FLAG, 0x123, 0x7FF, 0x100, 0x181]
    found["flags"] = [FDF | BRS, FDF, FDF | BRS | ESI, FDF | ESI, 0]
    found["length"] = [64, 12, 8, 1, 8]  # python-can's reader of .asc takes none for a remote frame
    found["data"] = np.arange(64) * (np.arange(64) < found["length"][:, None])
    return found


def written(folder: Path, form: str, records: NDArray[np.void]) -> Path:
    path = folder / f"frames{SUFFIXES[form]}"
    write_can_file(path, form, records, BUSES, EPOCH)
    return path


def compare(message: can.Message, frame: np.void, form: str) -> None:
    number = int(frame["id"])
    assert message.arbitration_id == number & 0x1FFF_FFFF
    assert message.is_extended_id == bool(number & EFF_FLAG)
    assert message.is_remote_frame == bool(number & RTR_FLAG)
    assert message.is_fd == bool(frame["flags"] & FDF)
    assert message.bitrate_switch == bool(frame["flags"] & BRS)
    assert message.error_state_indicator == bool(frame["flags"] & ESI)
    assert bytes(message.data) == frame["data"][: frame["length"]].tobytes()
    if form != "can-csv":  # which has neither
        assert message.is_rx == (not frame["tx"])
        first = 1 if form == "trc" else 0
        names = BUSES if form == "candump" else (first, first + 1)
        assert message.channel == names[frame["bus"]]


@pytest.mark.parametrize("form", [*WHOLE, "trc", "can-csv"])
def test_classical_frames_read_back(form: str, tmp_path: Path) -> None:
    frames = classical()
    found = list(can.LogReader(written(tmp_path, form, frames)))
    assert len(found) == len(frames)
    for message, frame in zip(found, frames, strict=True):
        compare(message, frame, form)
    times = np.array([message.timestamp for message in found])
    np.testing.assert_allclose(times - times[0], frames["t"], atol=2e-6)
    if form in ("candump", "can-csv"):
        assert times[0] == pytest.approx(EPOCH, abs=1e-6)


@pytest.mark.parametrize("form", WHOLE)
def test_fd_frames_read_back(form: str, tmp_path: Path) -> None:
    for message, frame in zip(can.LogReader(written(tmp_path, form, fd())), fd(), strict=True):
        compare(message, frame, form)


def test_candump_lines_by_hand(tmp_path: Path) -> None:
    frames = np.zeros(4, record_dtype(64))
    frames["t"] = [-1e-3, 0.0, 0.5, 1.0]
    frames["id"] = [0x44, EFF_FLAG | 0x8001, RTR_FLAG | 0x701, 0x123]
    frames["tx"] = [True, False, False, True]
    frames["bus"] = [0, 1, 0, 0]
    frames["length"] = [8, 1, 0, 3]
    frames["flags"] = [0, 0, 0, FDF | BRS]
    frames["data"][:, :8] = np.frombuffer(bytes.fromhex("2A366C2BBA071122"), np.uint8)
    assert written(tmp_path, "candump", frames).read_text() == (
        "(1436509052.249000) can0 044#2A366C2BBA071122 T\n"
        "(1436509052.250000) arm 00008001#2A R\n"
        "(1436509052.750000) can0 701#R R\n"
        "(1436509053.250000) can0 123##12A366C T\n"
    )


def test_a_time_before_1970_becomes_its_start(tmp_path: Path) -> None:
    frames = classical(2)
    frames["t"] = [-0.001, 0.5]
    path = tmp_path / "x.log"
    write_can_file(path, "candump", frames, BUSES, 0.0)
    assert re.findall(r"^\((.*?)\)", path.read_text(), re.MULTILINE) == ["0.000000", "0.500000"]


def test_text_has_a_line_a_frame(tmp_path: Path) -> None:
    assert len(written(tmp_path, "txt", classical(7)).read_text().splitlines()) == 7


@pytest.mark.parametrize("form", ["trc", "can-csv"])
def test_what_a_format_cannot_hold_is_refused(form: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"--to {form}: the log has CAN FD .*candump, asc, blf"):
        written(tmp_path, form, fd())
    assert list(tmp_path.iterdir()) == []


def test_trc_refuses_remote_frames(tmp_path: Path) -> None:
    frames = classical(1)
    frames["id"] = RTR_FLAG | 1
    with pytest.raises(InputError, match="remote frames"):
        written(tmp_path, "trc", frames)
