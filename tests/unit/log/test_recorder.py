"""What the recorder writes, as an independent decoder reads it."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Metadata
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

from dftc_rt.errors import EnvironmentLacksError, LogError
from dftc_rt.log.cdr import encode_event
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.recover import recover

from .conftest import JOINTS, SCENARIO, URDF, Sample, frames


def decoded(path: Path, topic: str) -> list[tuple[int, Any]]:
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [(m.log_time, d) for _, _, m, d in reader.iter_decoded_messages(topics=topic)]


def raw_records(path: Path) -> list[McapRecord]:
    with open(path, "rb") as stream:
        return list(StreamReader(stream, emit_chunks=True, validate_crcs=True).records)


@pytest.mark.parametrize("topic", ["/cycle", "/rig"])
def test_records_decode_to_the_numbers_written(sample: Sample, log: Path, topic: str) -> None:
    layout, records = (
        (sample.cycle, sample.cycles) if topic == "/cycle" else (sample.rig, sample.rigs)
    )
    messages = decoded(log, topic)
    assert [time for time, _ in messages] == [k * 1_000_000 for k in range(len(records))]
    for (_, message), record in zip(messages, records, strict=True):
        assert [getattr(message, name) for name in layout.fields] == record.tolist()


def test_joint_states_come_at_50_hz(sample: Sample, log: Path) -> None:
    messages = decoded(log, "/joint_states")
    assert [time for time, _ in messages] == [k * 20_000_000 for k in range(35)]
    rows = sample.cycles[::20, 7:].reshape(35, 15, 2)
    for (time, state), row in zip(messages, rows, strict=True):
        assert (state.header.stamp.sec, state.header.stamp.nanosec) == (0, time)
        assert tuple(state.name) == JOINTS
        assert list(state.position) == row[0].tolist()
        assert list(state.velocity) == row[1].tolist()
        assert list(state.effort) == row[6].tolist()


def test_slow_loops_log_every_cycle_as_joint_state(maker: Any, tmp_path: Path) -> None:
    sample = maker(10)
    sample.cycles[:, 0] = np.arange(10) * 0.02
    sample.write(tmp_path / "slow.mcap", block=3)
    assert len(decoded(tmp_path / "slow.mcap", "/joint_states")) == 10


def test_tf_holds_each_link(sample: Sample, log: Path) -> None:
    messages = decoded(log, "/tf")
    assert len(messages) == 35
    for (time, message), record in zip(messages, sample.cycles[::20], strict=True):
        expected = frames(record[7:9])
        assert len(message.transforms) == 2
        for transform, (parent, child, xyz, quaternion) in zip(
            message.transforms, expected, strict=True
        ):
            assert transform.header.stamp.nanosec == time
            assert (transform.header.frame_id, transform.child_frame_id) == (parent, child)
            place, turn = transform.transform.translation, transform.transform.rotation
            assert [place.x, place.y, place.z] == list(xyz)
            assert [turn.x, turn.y, turn.z, turn.w] == quaternion


def test_description_and_events(log: Path) -> None:
    (((time, description)),) = decoded(log, "/robot_description")
    assert (time, description.data) == (0, URDF)
    events = [event for _, event in decoded(log, "/events")]
    assert [(event.t, event.severity, event.source, event.text) for event in events] == [
        (0.0, 1, "controller", "läuft"),
        (0.25, 3, "can0", "bus off"),
    ]


def test_event_bytes_are_those_of_the_cdr_rules() -> None:
    # Header; t; severity and 3 bytes of padding; length 3, "ab\0", 1 of padding; length 1, "\0".
    expected = (
        bytes.fromhex("00010000")
        + struct.pack("<d", 1.5)
        + bytes.fromhex("02000000 03000000 61620000 01000000 00")
    )
    assert encode_event(1.5, 2, "ab", "") == expected


def test_what_the_run_is_comes_first(log: Path) -> None:
    records = raw_records(log)
    assert isinstance(records[0], Header)
    assert records[0].profile == "ros2"
    first_chunk = next(k for k, record in enumerate(records) if isinstance(record, Chunk))
    head = records[1:first_chunk]
    metadata = {record.name: record.metadata for record in head if isinstance(record, Metadata)}
    assert metadata["versions"] == {"numpy": "2", "dftc_rt": "0.1.0"}
    assert metadata["dftc_rt"] == {
        "joints": '["shoulder", "elbow.1"]',
        "epoch_ns": "0",
        "torque_limit_nm": "[87.0, 12.0]",
    }
    attachments = {r.name: r.data.decode() for r in head if isinstance(r, Attachment)}
    assert attachments == {"scenario.toml": SCENARIO, "robot.urdf": URDF}
    assert {record.compression for record in records if isinstance(record, Chunk)} == {"lz4"}


def test_messages_are_cdr_with_ros_2_type_names(log: Path) -> None:
    with open(log, "rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    types = {
        channel.topic: (channel.message_encoding, summary.schemas[channel.schema_id].name)
        for channel in summary.channels.values()
        if isinstance(channel, Channel)
    }
    assert types == {
        "/cycle": ("cdr", "dftc_rt/msg/Cycle"),
        "/rig": ("cdr", "dftc_rt/msg/Rig"),
        "/events": ("cdr", "dftc_rt/msg/Event"),
        "/joint_states": ("cdr", "sensor_msgs/msg/JointState"),
        "/tf": ("cdr", "tf2_msgs/msg/TFMessage"),
        "/robot_description": ("cdr", "std_msgs/msg/String"),
    }


def test_times_are_the_epoch_plus_t(sample: Sample, tmp_path: Path) -> None:
    epoch = 1_700_000_000_123_456_789
    sample.write(tmp_path / "hil.mcap", epoch_ns=epoch)
    times = [time for time, _ in decoded(tmp_path / "hil.mcap", "/cycle")]
    assert times[:3] == [epoch, epoch + 1_000_000, epoch + 2_000_000]
    (_, state), *_ = decoded(tmp_path / "hil.mcap", "/joint_states")
    assert (state.header.stamp.sec, state.header.stamp.nanosec) == (1_700_000_000, 123_456_789)


def test_the_same_records_give_the_same_file(sample: Sample, tmp_path: Path) -> None:
    for name in ("a", "b"):
        sample.write(tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_flush_makes_everything_before_it_readable(sample: Sample, tmp_path: Path) -> None:
    path, saved = tmp_path / "live.mcap", tmp_path / "saved.mcap"
    recorder = Recorder(path, sample.cycle)
    recorder.flush_due(10.0)  # the first one is always due
    recorder.write_cycles(sample.cycles[:100])
    recorder.flush_due(10.1)
    recover(path, saved)
    assert len(decoded(saved, "/cycle")) == 0
    recorder.flush_due(10.25)
    recorder.write_cycles(sample.cycles[100:101])
    recover(path, saved)
    assert len(decoded(saved, "/cycle")) == 100
    recorder.close()
    recorder.close()
    assert len(decoded(path, "/cycle")) == 101


def test_a_full_disk_is_told(sample: Sample) -> None:
    with pytest.raises(EnvironmentLacksError, match="no space left to write /dev/full"):
        Recorder("/dev/full", sample.cycle)


def test_a_place_that_cannot_be_written_is_told(sample: Sample, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be written: No such file or directory"):
        Recorder(tmp_path / "none" / "x.mcap", sample.cycle)
    (tmp_path / "there").write_text("precious")
    with pytest.raises(LogError, match="cannot be written: File exists"):
        Recorder(tmp_path / "there", sample.cycle, overwrite=False)
    assert (tmp_path / "there").read_text() == "precious"


def test_rig_records_need_a_rig_layout(sample: Sample, tmp_path: Path) -> None:
    with Recorder(tmp_path / "x.mcap", sample.cycle) as recorder:
        recorder.write_cycles(sample.cycles[:0])
        with pytest.raises(LogError, match="a rig record"):
            recorder.write_rig(sample.rigs)
