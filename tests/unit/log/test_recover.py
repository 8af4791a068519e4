"""Everything before the tear comes back, wherever the tear is."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from dftc_rt.errors import LogError
from dftc_rt.log.reader import read
from dftc_rt.log.recover import recover

from .conftest import SCENARIO, URDF, Sample


def messages(path: Path) -> list[tuple[str, int, int, bytes]]:
    with open(path, "rb") as stream:
        found = make_reader(stream).iter_messages(log_time_order=False)
        return [(c.topic, m.log_time, m.sequence, m.data) for _, c, m in found]


def test_whole_log_is_copied_whole(log: Path, tmp_path: Path) -> None:
    done = recover(log, tmp_path / "copy.mcap")
    assert done.whole
    assert messages(tmp_path / "copy.mcap") == messages(log)
    assert done.messages == len(messages(log))
    assert (done.attachments, done.metadata) == (2, 2)


def test_any_tear_leaves_what_came_before(sample: Sample, log: Path, tmp_path: Path) -> None:
    content, everything = log.read_bytes(), messages(log)
    torn, saved = tmp_path / "torn.mcap", tmp_path / "saved.mcap"
    rng = np.random.default_rng(3)
    first = 500  # where the first record ends that says anything
    for cut in (8, 9, 30):
        torn.write_bytes(content[:cut])
        with pytest.raises(LogError, match="nothing in it can be read"):
            recover(torn, saved)
        assert not saved.exists()
    cuts = sorted({first, len(content) - 1, *rng.integers(first, len(content), 60).tolist()})
    counts = []
    for cut in cuts:
        torn.write_bytes(content[:cut])
        done = recover(torn, saved)
        assert not done.whole
        kept = messages(saved)
        assert kept == everything[: len(kept)]
        assert done.messages == len(kept)
        counts.append(len(kept))
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[-1] == len(everything)  # only the last byte is missing
    assert len(set(counts)) > 2


def test_a_recovered_log_reads_as_a_shorter_run(sample: Sample, log: Path, tmp_path: Path) -> None:
    torn, saved = tmp_path / "torn.mcap", tmp_path / "saved.mcap"
    torn.write_bytes(log.read_bytes()[: int(log.stat().st_size * 0.6)])
    recover(torn, saved)
    run = read(saved)
    count = len(run.cycle["t"])
    assert 0 < count < 700
    np.testing.assert_array_equal(run.cycle["t"], sample.cycles[:count, 0])
    assert (run.scenario, run.urdf) == (SCENARIO, URDF)
    assert run.metadata["versions"]["numpy"] == "2"


def test_noise_after_the_tear_is_left_out(log: Path, tmp_path: Path) -> None:
    content = log.read_bytes()
    torn, saved = tmp_path / "torn.mcap", tmp_path / "saved.mcap"
    rng = np.random.default_rng(4)
    whole = messages(log)
    for cut in rng.integers(8, len(content), 20).tolist():
        torn.write_bytes(content[:cut] + rng.bytes(5000))
        recover(torn, saved)
        kept = messages(saved)
        assert kept == whole[: len(kept)]


def test_noise_after_the_magic_is_no_log(tmp_path: Path) -> None:
    noise, target = tmp_path / "noise.mcap", tmp_path / "saved.mcap"
    target.write_bytes(b"an earlier one")
    for seed in range(20):
        noise.write_bytes(b"\x89MCAP0\r\n" + np.random.default_rng(seed).bytes(4000))
        with pytest.raises(LogError, match="nothing in it can be read") as caught:
            recover(noise, target)
        assert str(noise) in str(caught.value)
    assert target.read_bytes() == b"an earlier one"
    assert sorted(tmp_path.iterdir()) == [noise, target]


def test_a_whole_log_without_a_record_is_whole(tmp_path: Path) -> None:
    empty = tmp_path / "empty.mcap"
    with open(empty, "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        writer.finish()
    done = recover(empty, tmp_path / "copy.mcap")
    assert done.whole
    assert done.messages == 0


def test_what_cannot_be_repaired_is_one_line(log: Path, tmp_path: Path) -> None:
    foreign = tmp_path / "notes.txt"
    foreign.write_text("no log")
    with pytest.raises(LogError, match="no MCAP file"):
        recover(foreign, tmp_path / "x.mcap")
    assert not (tmp_path / "x.mcap").exists()
    with pytest.raises(LogError, match="No such file"):
        recover(tmp_path / "none.mcap", tmp_path / "x.mcap")
    with pytest.raises(LogError, match="the log itself"):
        recover(log, log)
    with pytest.raises(LogError, match="No such file"):
        recover(log, tmp_path / "none" / "x.mcap")


def test_what_is_no_plain_file_is_not_replaced(tmp_path: Path) -> None:
    source, pipe = tmp_path / "run.mcap", tmp_path / "pipe"
    source.write_bytes(b"\x89MCAP0\r\n")
    os.mkfifo(pipe)
    for target in (pipe, tmp_path):
        with pytest.raises(LogError, match="no plain file"):
            recover(source, target)
    assert pipe.is_fifo()
