"""A run in several files is one run again, as far as they can be read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dftc_rt.errors import LogError
from dftc_rt.log.pieces import read_pieces
from dftc_rt.log.reader import read
from dftc_rt.log.recorder import Recorder

from .conftest import SCENARIO, Maker, Sample


def part(sample: Sample, path: Path, start: int, end: int, torn: bool = False) -> Path:
    piece = Sample(sample.cycle, sample.rig, sample.cycles[start:end], sample.rigs[start:end])
    piece.write(path)
    if torn:
        path.write_bytes(path.read_bytes()[:-100])
    return path


def test_one_whole_file_is_read_as_it_is(log: Path, sample: Sample) -> None:
    run, note = read_pieces([log])
    assert note == ""
    np.testing.assert_array_equal(run.cycle["t"], sample.cycles[:, 0])


def test_a_torn_file_and_the_next_are_one_run(maker: Maker, tmp_path: Path) -> None:
    sample = maker(700)
    first = part(sample, tmp_path / "run.mcap", 0, 300, torn=True)
    second = part(sample, tmp_path / "run.2.mcap", 280, 700)  # twenty of them once more
    with pytest.raises(LogError, match="torn"):
        read(first)
    run, note = read_pieces([first, second])
    assert note == f"the summary is made of 2 of 2 files, {first} up to its tear"
    np.testing.assert_array_equal(run.cycle["t"], sample.cycles[:, 0])
    np.testing.assert_array_equal(run.cycle["q"], sample.cycles[:, 7:9])
    assert run.rig is not None
    np.testing.assert_array_equal(run.rig["rho"], sample.rigs[:, 7:9])
    assert run.scenario == SCENARIO
    assert [event.text for event in run.events] == ["läuft", "bus off"]


def test_a_piece_with_the_truth_alone_belongs_to_the_run(maker: Maker, tmp_path: Path) -> None:
    sample = maker(700)
    first = part(sample, tmp_path / "run.mcap", 0, 300)
    second = tmp_path / "run.2.mcap"  # of a recorder that began when the controller had gone
    with Recorder(second, sample.cycle, sample.rig) as recorder:
        recorder.write_rig(sample.rigs[300:])
    run, note = read_pieces([first, second])
    assert note == "the summary is made of 2 of 2 files"
    np.testing.assert_array_equal(run.cycle["t"], sample.cycles[:300, 0])
    assert run.rig is not None
    np.testing.assert_array_equal(run.rig["rho"], sample.rigs[:, 7:9])
    for only in (lambda: read(second), lambda: read_pieces([second])):
        with pytest.raises(LogError, match=r"run\.2\.mcap: no topic /cycle"):
            only()


def test_what_cannot_be_read_is_said(maker: Maker, tmp_path: Path) -> None:
    whole = part(maker(700), tmp_path / "run.2.mcap", 300, 700)
    empty, none = tmp_path / "run.mcap", tmp_path / "run.3.mcap"
    empty.write_bytes(b"\x89MCAP0\r\n")
    run, note = read_pieces([empty, whole, none])
    assert len(run.cycle["t"]) == 400
    assert note == f"the summary is made of 1 of 3 files, nothing in {empty}, nothing in {none}"
    with pytest.raises(LogError, match="no topic /cycle"):
        read_pieces([empty, none])


@pytest.mark.parametrize("share", [0.5, 0.7, 0.9])
def test_one_torn_file_is_read_up_to_its_tear(log: Path, sample: Sample, share: float) -> None:
    log.write_bytes(log.read_bytes()[: int(log.stat().st_size * share)])
    run, note = read_pieces([log])
    assert note == f"the summary is made of {log} up to its tear"
    count = len(run.cycle["t"])
    assert 0 < count < 700
    np.testing.assert_array_equal(run.cycle["t"], sample.cycles[:count, 0])
