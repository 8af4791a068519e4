"""A log becomes arrays again, or one line that says why not."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from dftc_rt.control.signals import NAMES
from dftc_rt.errors import InputError, LogError
from dftc_rt.log.reader import read
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.run import Run
from dftc_rt.log.schema import cycle_layout
from dftc_rt.ring import Event

from .conftest import JOINTS, SCENARIO, URDF, Sample


def test_reads_what_was_written(sample: Sample, log: Path) -> None:
    run = read(log)
    assert run.joints == JOINTS
    assert (run.scenario, run.urdf) == (SCENARIO, URDF)
    assert run.torque_limit == (87.0, 12.0)
    assert run.metadata["versions"]["numpy"] == "2"
    assert run.events == (
        Event(0.0, 1, "controller", "läuft"),
        Event(0.25, 3, "can0", "bus off"),
    )
    matrix = sample.cycles[:, 7:].reshape(-1, 15, 2)
    for i, name in enumerate(NAMES):
        np.testing.assert_array_equal(run.cycle[name], matrix[:, i])
    header = ("t", "lateness", "compute", "exchange", "state", "overruns", "skipped")
    for i, name in enumerate(header):
        np.testing.assert_array_equal(run.cycle[name], sample.cycles[:, i])
    assert run.rig is not None
    np.testing.assert_array_equal(run.rig["rho"], sample.rigs[:, 7:9])
    np.testing.assert_array_equal(run.rig["t"], sample.rigs[:, 0])


def test_a_log_equals_the_run_from_memory(sample: Sample, log: Path) -> None:
    from_log = read(log)
    from_memory = Run.from_records(
        sample.cycle,
        sample.cycles,
        sample.rigs,
        scenario=SCENARIO,
        events=from_log.events,
        torque_limit=np.array([87.0, 12.0]),
    )
    assert from_memory.rig is not None
    assert from_log.rig is not None
    for ours, theirs in ((from_memory.cycle, from_log.cycle), (from_memory.rig, from_log.rig)):
        assert ours.keys() == theirs.keys()
        for name in ours:
            np.testing.assert_array_equal(ours[name], theirs[name])
    assert from_memory.torque_limit == from_log.torque_limit
    assert from_memory.joints == from_log.joints


def test_records_of_another_width_are_refused(sample: Sample) -> None:
    with pytest.raises(InputError, match=r"/cycle: records of shape \(700, 36\)"):
        Run.from_records(sample.cycle, sample.cycles[:, :-1])


def test_without_a_rig_there_is_none(sample: Sample, tmp_path: Path) -> None:
    with Recorder(tmp_path / "x.mcap", sample.cycle) as recorder:
        recorder.write_cycles(sample.cycles)
    run = read(tmp_path / "x.mcap")
    assert run.rig is None
    assert run.torque_limit is None
    assert run.events == ()
    assert len(run.cycle["t"]) == 700


def other_log(
    topic: str,
    definition: str,
    *payloads: bytes,
    compression: CompressionType = CompressionType.LZ4,
) -> bytes:
    """A whole MCAP file by another writer, without our metadata."""
    out = io.BytesIO()
    writer = Writer(out, compression=compression)
    writer.start("ros2")
    schema = writer.register_schema("x/msg/X", "ros2msg", definition.encode())
    channel = writer.register_channel(topic, "cdr", schema)
    for payload in payloads:
        writer.add_message(channel, 0, payload, 0)
    writer.finish()
    return out.getvalue()


def test_joints_come_from_the_fields_when_metadata_is_gone(tmp_path: Path) -> None:
    layout = cycle_layout(["a", "b"], NAMES)
    record = np.arange(layout.size, dtype="<f8")
    payload = b"\x00\x01\x00\x00" + record.tobytes()
    (tmp_path / "x.mcap").write_bytes(other_log("/cycle", layout.definition, payload, payload))
    run = read(tmp_path / "x.mcap")
    assert run.joints == ("a", "b")
    assert run.cycle["q"].tolist() == [[7.0, 8.0]] * 2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no MCAP file"),
        (b"# a text file, and long enough", "no MCAP file"),
        (b"\x89MCAP0\r\n", "torn.*dftc recover"),
        (b"\x89MCAP0\r\n" * 2, "damaged"),
        (other_log("/other", "float64 t\n"), "no topic /cycle"),
        (other_log("/cycle", "float64 t\n"), "no topic /cycle|another program"),
        (other_log("/cycle", "float64 t\n", b"\0\1\0\0" + bytes(8)), "another program"),
        (other_log("/cycle", "float64 t\nfloat64 q_a\n", b"\0\1\0\0" + bytes(9)), "length"),
    ],
)
def test_what_is_no_log_is_one_line(content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=message) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="No such file"):
        read(tmp_path / "none.mcap")


def test_a_flipped_bit_is_found(log: Path, tmp_path: Path) -> None:
    content = bytearray(log.read_bytes())
    content[len(content) // 2] ^= 1
    path = tmp_path / "flipped.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"damaged.*dftc recover"):
        read(path)


def test_a_flipped_bit_is_found_by_the_checksum_alone(tmp_path: Path) -> None:
    layout = cycle_layout(("a",), NAMES)
    definition, payload = layout.definition, b"\0\1\0\0" + b"\x55" * 8 * layout.size
    content = other_log("/cycle", definition, payload, compression=CompressionType.NONE)
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    assert read(path).cycle["q"].shape == (1, 1)
    path.write_bytes(content.replace(b"\x55" * 16, b"\x55" * 15 + b"\x54"))
    with pytest.raises(LogError, match="damaged"):
        read(path)


def test_a_torn_log_says_how_to_repair_it(log: Path, tmp_path: Path) -> None:
    path = tmp_path / "torn.mcap"
    path.write_bytes(log.read_bytes()[:-1000])
    with pytest.raises(LogError, match=f"dftc recover {path}"):
        read(path)
