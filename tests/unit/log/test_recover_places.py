"""A tear at every kind of place: what is complete before it comes back, and nothing else."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import lz4.frame
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader

from dftc_rt.cli.main import run
from dftc_rt.errors import LogError
from dftc_rt.log.reader import read
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.recover import recover

from .conftest import Sample
from .test_frames import CLASSICAL, made, words

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE = 1, 2, 3, 4, 5
CHUNK, INDEX, ATTACHMENT, METADATA, DATA_END = 6, 7, 9, 12, 15


@dataclass(frozen=True)
class Place:
    """A record in the file, found by the format's own rule: opcode, length, content."""

    opcode: int
    start: int
    end: int


@dataclass(frozen=True)
class Content:
    """What there is in a file."""

    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]
    messages: list[tuple[str, int, bytes]]


@pytest.fixture
def torn(sample: Sample, tmp_path: Path) -> Path:
    """Return a log with every kind of record, frames included."""
    path = tmp_path / "run.mcap"
    options = {"scenario": "name = 'x'\n", "urdf": "<robot/>" * 900, "versions": {"a": "1"}}
    with Recorder(path, sample.cycle, sample.rig, CLASSICAL, **options) as out:
        for at in range(0, 60, 20):
            out.write_cycles(sample.cycles[at : at + 20])
            out.write_rig(sample.rigs[at : at + 20])
            out.write_frames(words(made(CLASSICAL, 30, at), CLASSICAL))
            out.flush()
        out.write_event(0.1, 3, "can0", "bus off")
    return path


def places(data: bytes) -> list[Place]:
    found, at = [], 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append(Place(opcode, at, at + 9 + length))
        at += 9 + length
    return found


def messages_in(data: bytes, chunk: Place) -> int:
    """Count the messages of a chunk: times, sizes, checksum, compression, then the records."""
    at = chunk.start + 9 + 8 + 8 + 8 + 4
    at += 4 + struct.unpack_from("<I", data, at)[0] + 8
    inside, count, at = lz4.frame.decompress(data[at : chunk.end]), 0, 0
    while at < len(inside):
        opcode, length = struct.unpack_from("<BQ", inside, at)
        count += opcode == MESSAGE
        at += 9 + length
    return count


def content(path: Path) -> Content:
    with open(path, "rb") as stream:
        reader = make_reader(stream)
        return Content(
            {a.name: a.data for a in reader.iter_attachments()},
            {m.name: m.metadata for m in reader.iter_metadata()},
            [
                (c.topic, m.log_time, m.data)
                for _, c, m in reader.iter_messages(None, None, None, False)
            ],
        )


def test_the_log_has_a_record_of_every_kind(torn: Path) -> None:
    data = torn.read_bytes()
    kinds = [place.opcode for place in places(data)]
    assert kinds[0] == HEADER
    assert kinds[-1] == FOOTER
    assert kinds.count(CHUNK) >= 4
    assert {kinds.count(kind) for kind in (ATTACHMENT, METADATA)} == {2}
    assert {SCHEMA, CHANNEL, INDEX, DATA_END, Opcode.STATISTICS, Opcode.SUMMARY_OFFSET} <= {*kinds}
    assert {Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX} <= {*kinds}


def test_a_tear_before_in_and_behind_every_record(torn: Path, tmp_path: Path) -> None:
    data, whole = torn.read_bytes(), content(torn)
    found = places(data)
    source, saved = tmp_path / "torn.mcap", tmp_path / "saved.mcap"
    seen = set()
    for place in found:
        middle = (place.start + place.end) // 2
        for cut in {place.start, place.start + 1, place.start + 9, middle, place.end - 1}:
            before = [other for other in found if other.end <= cut]
            count = {kind: sum(p.opcode == kind for p in before) for kind in (ATTACHMENT, METADATA)}
            messages = sum(messages_in(data, p) for p in before if p.opcode == CHUNK)
            source.write_bytes(data[:cut])
            if not (messages or any(count.values())):
                with pytest.raises(LogError, match=r"torn.mcap: nothing in it can be read"):
                    recover(source, saved)
                assert not saved.exists()
                continue
            done = recover(source, saved)
            assert (done.messages, done.whole) == (messages, False)
            assert (done.attachments, done.metadata) == (count[ATTACHMENT], count[METADATA])
            back = content(saved)
            assert back.messages == whole.messages[:messages]
            assert (
                list(back.attachments.items())
                == list(whole.attachments.items())[: done.attachments]
            )
            assert list(back.metadata.items()) == list(whole.metadata.items())[: done.metadata]
            assert recover(saved, tmp_path / "again.mcap").whole
            saved.unlink()
            seen.add((done.attachments, done.metadata, done.messages))
    assert {(0, 1, 0), (0, 2, 0), (1, 2, 0), (2, 2, 0), (2, 2, len(whole.messages))} <= seen
    assert len(seen) == 4 + sum(place.opcode == CHUNK for place in found)


def test_a_tear_within_the_end_magic_loses_nothing(torn: Path, tmp_path: Path) -> None:
    data, whole = torn.read_bytes(), content(torn)
    source, saved = tmp_path / "torn.mcap", tmp_path / "saved.mcap"
    for missing in range(1, 9):
        source.write_bytes(data[:-missing])
        assert not recover(source, saved).whole
        assert content(saved) == whole


def test_zeros_behind_the_tear_are_no_records(torn: Path, tmp_path: Path) -> None:
    """As a file system leaves them behind a power cut."""
    data = torn.read_bytes()
    source, saved = tmp_path / "torn.mcap", tmp_path / "saved.mcap"
    for place in places(data)[2:]:
        for cut in (place.start, (place.start + place.end) // 2):
            source.write_bytes(data[:cut] + bytes(4096))
            done = recover(source, saved)
            assert not done.whole
            assert content(saved).messages == content(torn).messages[: done.messages]


@pytest.mark.parametrize(
    ("kept", "told"),
    [
        (0, "no MCAP file"),
        (7, "no MCAP file"),
        (8, "nothing in it can be read"),
        (8 + 9 + 55, "nothing in it can be read"),  # the header alone
    ],
)
def test_files_with_nothing_in_them_are_one_line(
    kept: int, told: str, torn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, source = torn.read_bytes(), tmp_path / "torn.mcap"
    assert places(data)[0].end == 8 + 9 + 55
    source.write_bytes(data[:kept])
    assert run(["recover", str(source), "-o", str(tmp_path / "x.mcap")]) == 2
    assert capsys.readouterr().err == (f"dftc: {source}: {told} (expected a log written by dftc)\n")
    assert not (tmp_path / "x.mcap").exists()


def test_a_damaged_attachment_is_left_out_and_named(
    torn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, saved = bytearray(torn.read_bytes()), tmp_path / "saved.mcap"
    first = next(place for place in places(data) if place.opcode == ATTACHMENT)
    assert (
        zlib.crc32(data[first.start + 9 : first.end - 4])
        == struct.unpack_from("<I", data, first.end - 4)[0]
    )
    at = data.index(b"name = 'x'", first.start)
    data[at + 8] ^= 1
    source = tmp_path / "damaged.mcap"
    source.write_bytes(data)
    with pytest.raises(LogError, match=r"damaged \(expected a whole log; dftc recover"):
        read(source)
    assert run(["recover", str(source), "-o", str(saved)]) == 0
    assert "(damaged and left out: scenario.toml)" in capsys.readouterr().out
    back, whole = content(saved), content(torn)
    assert back.messages == whole.messages
    assert list(back.attachments) == ["robot.urdf"]
