"""Frames in a log: written as they were in the ring, read back, and decoded by others."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

from dftc_rt.analysis import load
from dftc_rt.bus.frame_record import record_dtype
from dftc_rt.errors import InputError, LogError
from dftc_rt.log.process import dropped_records, record
from dftc_rt.log.reader import read
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.schema import CanLayout
from dftc_rt.ring import Ring

from .conftest import Sample

CLASSICAL = CanLayout(("can0", "left"), 8)
FD = CanLayout(("can0",), 64)


def made(layout: CanLayout, count: int, seed: int = 1) -> NDArray[np.void]:
    """Return frames whose every byte is drawn."""
    rng = np.random.default_rng(seed)
    found = np.zeros(count, record_dtype(layout.data_bytes))
    found["t"] = np.arange(count) * 1e-4
    found["id"] = rng.integers(0, 1 << 32, count)
    found["bus"] = rng.integers(0, len(layout.buses), count)
    found["tx"] = rng.integers(0, 2, count)
    found["flags"] = rng.integers(0, 8, count)
    found["length"] = rng.integers(0, layout.data_bytes + 1, count)
    found["data"] = rng.integers(0, 256, (count, layout.data_bytes))
    return found


def words(records: NDArray[np.void], layout: CanLayout) -> NDArray[np.float64]:
    return records.view(np.float64).reshape(len(records), layout.size)


def write(path: Path, sample: Sample, layout: CanLayout, frames: NDArray[np.void]) -> None:
    with Recorder(path, sample.cycle, sample.rig, layout) as recorder:
        for at in range(0, len(sample.cycles), 50):
            recorder.write_cycles(sample.cycles[at : at + 50])
        for at in range(0, len(frames), 777):
            recorder.write_frames(words(frames, layout)[at : at + 777])


@pytest.mark.parametrize("layout", [CLASSICAL, FD], ids=["classical", "fd"])
def test_frames_come_back_bit_for_bit(layout: CanLayout, sample: Sample, tmp_path: Path) -> None:
    frames = made(layout, 5000)
    write(tmp_path / "x.mcap", sample, layout, frames)
    assert read(tmp_path / "x.mcap").can is None  # nobody asked for them
    run = load(tmp_path / "x.mcap")
    assert run.can is not None
    assert run.can.buses == layout.buses
    assert run.can.records.tobytes() == frames.tobytes()
    np.testing.assert_array_equal(run.cycle["t"], sample.cycles[:, 0])


def test_ros2_tools_decode_them(sample: Sample, tmp_path: Path) -> None:
    frames = made(CLASSICAL, 40)
    write(tmp_path / "x.mcap", sample, CLASSICAL, frames)
    with open(tmp_path / "x.mcap", "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        found = [m for _, _, _, m in reader.iter_decoded_messages(topics=["/can"])]
    assert len(found) == 40
    for message, frame in zip(found, frames, strict=True):
        for name in ("t", "id", "bus", "tx", "flags", "length"):
            assert getattr(message, name) == frame[name]
        assert list(message.data) == frame["data"].tolist()


def test_a_log_without_frames_has_none(log: Path) -> None:
    assert load(log).can is None
    with pytest.raises(InputError, match="/can: not in this run"):
        load(log).columns("/can")


def test_a_recorder_without_their_layout_refuses_them(sample: Sample, tmp_path: Path) -> None:
    with Recorder(tmp_path / "x.mcap", sample.cycle) as recorder, pytest.raises(LogError):
        recorder.write_frames(np.zeros((1, 3)))


def test_other_fields_are_one_line(sample: Sample, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    write(path, sample, CLASSICAL, made(CLASSICAL, 3))
    data = path.read_bytes()  # the metadata says other buses than the definition
    assert data.count(json.dumps(["can0", "left"]).encode()) > 0
    path.write_bytes(data.replace(b'["can0", "left"]', b'["can1", "left"]'))
    assert read(path)  # nobody asked for frames
    with pytest.raises(LogError, match="/can: fields of another program"):
        read(path, frames=True)


def drained(ring: Ring, sample: Sample, path: Path, *, close: bool = True) -> NDArray[np.void]:
    """Return what a recorder's loop makes of a ring whose writer has gone."""
    cycles = Ring.create("cycle", 16, sample.cycle.size)
    cycles.slot()[:] = sample.cycles[0]
    cycles.commit()
    cycles.end()
    if close:
        ring.end()
    with Recorder(path, sample.cycle, None, CLASSICAL) as recorder:
        done = record(
            cycles, None, [], recorder, lambda: not close, frame_ring=ring, wait=lambda s: None
        )
    run = load(path)
    assert run.can is not None
    assert done.frames == len(run.can.records)
    assert dropped_records(run.events, "can") == done.dropped["can"] == ring.dropped
    return run.can.records


def test_times_count_from_the_first_tick(sample: Sample, tmp_path: Path) -> None:
    ring = Ring.create("can", 32, CLASSICAL.size)
    frames = made(CLASSICAL, 20)
    frames["t"] += 1000.0
    ring.put(words(frames, CLASSICAL), 20)
    ring.start(1_000_001_000_000)
    found = drained(ring, sample, tmp_path / "x.mcap")
    np.testing.assert_allclose(found["t"], np.arange(20) * 1e-4 - 1e-3, atol=1e-12)
    assert found["id"].tolist() == frames["id"].tolist()


@pytest.mark.parametrize("close", [True, False])
def test_frames_of_a_set_up_that_failed_are_kept(
    close: bool, sample: Sample, tmp_path: Path
) -> None:
    ring = Ring.create("can", 32, CLASSICAL.size)
    frames = made(CLASSICAL, 20)
    ring.put(words(frames, CLASSICAL), 20)
    found = drained(ring, sample, tmp_path / "x.mcap", close=close)
    assert found["t"][-1] == 0.0
    assert found["id"].tolist() == frames["id"].tolist()


def test_dropped_frames_are_told(sample: Sample, tmp_path: Path) -> None:
    ring = Ring.create("can", 16, CLASSICAL.size)
    ring.start(0)
    ring.put(words(made(CLASSICAL, 30), CLASSICAL), 30)
    assert len(drained(ring, sample, tmp_path / "x.mcap")) == 16
    assert dropped_records(load(tmp_path / "x.mcap").events, "can") == 14
    assert dropped_records(load(tmp_path / "x.mcap").events, "cycle") == 0


def test_a_topic_as_named_columns_and_as_a_data_frame(sample: Sample, tmp_path: Path) -> None:
    frames = made(CLASSICAL, 40)
    frames["length"] = 3
    write(tmp_path / "x.mcap", sample, CLASSICAL, frames)
    run = load(tmp_path / "x.mcap")
    columns = run.columns()
    assert tuple(columns) == sample.cycle.fields
    for k, name in enumerate(sample.cycle.fields):
        np.testing.assert_array_equal(columns[name], sample.cycles[:, k])
    table = run.frame()
    assert table.index.name == "t"
    assert table["rho_hat_elbow_1"].tolist() == columns["rho_hat_elbow_1"].tolist()
    can = run.frame("/can")
    assert can["bus"].tolist() == [CLASSICAL.buses[k] for k in frames["bus"]]
    assert can["data"].tolist() == [row[:3].tobytes() for row in frames["data"]]
