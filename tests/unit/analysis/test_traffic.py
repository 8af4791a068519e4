"""Load of the buses of a run, against bits counted by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dftc_rt.analysis.traffic import bus_traffic
from dftc_rt.bus.frame_record import record_dtype
from dftc_rt.log.run import CanFrames, Run

from .conftest import Maker

SCENARIO = (
    '[bus]\nbitrate = 1000000\ndata_bitrate = 5000000\nprofile = "{}"\n'
    "[executor]\nrate_hz = 1000.0\n"
)
ROBOT = b'[[joint]]\nname = "a"\nbus = "can0"\n[[joint]]\nname = "b"\nbus = "can1"\n'


def frames(t: np.ndarray, data: int = 8, **fields: object) -> np.ndarray:
    records = np.zeros(len(t), record_dtype(data))
    records["t"] = t
    for name, value in fields.items():
        records[name] = value
    return records


def wired(make: Maker, records: np.ndarray | None = None, profile: str = "cia402") -> Run:
    can = None if records is None else CanFrames(("can0", "can1"), records)
    run = make(SCENARIO.format(profile))
    return dataclasses.replace(run, attachments={"robot.toml": ROBOT}, can=can)


def test_frames_count_with_their_own_stuffing_in_their_own_time(make: Maker) -> None:
    # Identifier 0x555 without data: 47 bits, and at most 8 of stuffing.
    steady = frames(np.arange(1000) * 0.01 + 0.005, id=0x555, length=0)
    burst = frames(np.full(100, 4.55), id=0x555, length=0, bus=1)
    before = frames(np.full(50, -1.0), id=0x555, length=0)
    found = bus_traffic(wired(make, np.concatenate([before, steady, burst])))
    first, second = found
    assert (first.name, first.joints, first.bitrate) == ("can0", 1, 1_000_000)
    bits = first.load * 0.1 * 1e6 / 10  # of each of the ten frames in 0.1 s
    assert np.unique(np.round(bits)).size == 1
    assert 47 <= bits[0] <= 47 + 8
    assert second.load.argmax() == 45
    assert second.t[45] == pytest.approx(4.55)
    assert second.load[45] == pytest.approx(10 * first.load[45], rel=1e-9)
    assert second.mean == pytest.approx(second.load[45] / len(second.load))


def test_the_data_part_of_can_fd_is_faster(make: Maker) -> None:
    t = np.arange(1000) * 0.01 + 0.005
    classical = bus_traffic(wired(make, frames(t, 64, id=0x123, length=8)))[0].mean
    fd = bus_traffic(wired(make, frames(t, 64, id=0x123, length=8, flags=4 | 1)))[0].mean
    assert classical is not None
    assert fd is not None
    assert 0.3 < fd / classical < 0.7


def test_error_frames_are_no_traffic(make: Maker) -> None:
    errors = frames(np.arange(1000) * 0.01, id=0x20000004, length=8)
    assert bus_traffic(wired(make, errors))[0].mean == 0.0


def test_without_frames_the_plan_and_what_the_rig_counted(make: Maker) -> None:
    run = wired(make)
    (first, second) = bus_traffic(run)
    assert first.mean is None
    assert not len(first.load)
    assert first.planned is not None
    assert first.worst is not None
    assert 0.1 < first.planned < first.worst < 0.9
    counted = {"can1": {"bitrate": 1_000_000, "exact_bits": 2_000_000, "data_bitrate": 0}}
    first, second = bus_traffic(run, counted)
    assert first.mean is None
    assert second.mean == pytest.approx(0.2)  # 2 s of wire in 10 s


def test_a_log_that_does_not_say_how_it_was_wired_has_no_buses(make: Maker) -> None:
    assert bus_traffic(make()) == []
    assert bus_traffic(make(SCENARIO.format("cia402"))) == []


def test_a_profile_without_a_budget_has_no_plan(make: Maker) -> None:
    assert bus_traffic(wired(make, profile="other"))[0].planned is None
