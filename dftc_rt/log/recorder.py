"""Writes a run to MCAP: records as they lie in memory, and the ROS 2 messages viewers know.

The writer is foxglove-sdk's (Rust): chunks are compressed in line and handed to the file
whole, so a file that ends early ends in at most one torn chunk. The file object is ours,
because the SDK logs a failed write and goes on, where a recorder must stop and say so.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self, cast

import foxglove
import numpy as np
from foxglove.mcap import MCAPCompression, MCAPWriteOptions
from numpy.typing import NDArray

from dftc_rt.errors import InputError, LogError
from dftc_rt.log import cdr
from dftc_rt.log.file import LogFile
from dftc_rt.log.live import MARK, LiveServer, for_file
from dftc_rt.log.schema import CDR_HEADER, SCENARIO, URDF, CanLayout, Layout

if TYPE_CHECKING:
    from typing import BinaryIO

LinkFrames = Callable[[NDArray[np.float64]], Iterable[cdr.Frame]]
"""q, shape (n,), rad → parent, child, xyz in m and quaternion (x, y, z, w) of each link."""

CHUNK_BYTES: Final = 1 << 20  # of each the writer keeps its index, some 300 bytes, until the end
FLUSH_S: Final = 0.2  # with a drain every 20 ms, a killed process loses less than 300 ms
VIEW_HZ: Final = 50.0
_ROWS_AT_ONCE: Final = 4096
_WARNING: Final = 2
_MEDIA_TYPES: Final = {".toml": "application/toml", ".urdf": "application/xml", ".csv": "text/csv"}


class Recorder:
    """One log file, open for writing.

    Everything that tells what the run is (resolved scenario, URDF, versions, joint names)
    is written first, so that a torn log still says what it is of.

    Times in the file are ``epoch_ns`` plus the run time ``t``: two runs with the same seed
    and ``epoch_ns=0`` have the same times.
    """

    def __init__(
        self,
        path: str | Path,
        cycle: Layout,
        rig: Layout | None = None,
        can: CanLayout | None = None,
        *,
        scenario: str = "",
        urdf: str = "",
        files: Mapping[str, bytes] | None = None,
        versions: Mapping[str, str] | None = None,
        notes: Mapping[str, Mapping[str, str]] | None = None,
        torque_limit: Sequence[float] | NDArray[np.float64] | None = None,
        epoch_ns: int = 0,
        link_frames: LinkFrames | None = None,
        overwrite: bool = True,
        live_port: int | None = None,
        live_name: str = "dftc",
    ) -> None:
        """Create the file and write its attachments and metadata.

        Args:
            path: File to write.
            cycle: Layout of ``/cycle``, whose rows include q, v and tau_cmd.
            rig: Layout of ``/rig``; None when there is no rig (real drives).
            can: Layout of ``/can``; None when frames are not logged.
            scenario: Resolved scenario, TOML: attachment ``scenario.toml``.
            urdf: Attachment ``robot.urdf`` and topic ``/robot_description``.
            files: Further attachments by name: what the controller was made of.
            versions: Metadata ``versions``: package → version.
            notes: Further metadata by name.
            torque_limit: What commands are held to, n of them, Nm: whoever counts
                saturation needs it.
            epoch_ns: Unix time of t = 0, ns; 0 for a simulation.
            link_frames: Link poses for ``/tf``; without it there is no ``/tf``.
            overwrite: Replace a file of that name.
            live_port: Port of this machine on which viewers see it as it is logged; None: none.
                One that cannot be opened is an event of the log, which matters more.
            live_name: What they show as its name.

        Raises:
            LogError: The file cannot be created, or exists and may not be replaced.
            EnvironmentLacksError: The disk is full.
        """
        self.path = Path(path)
        self._cycle = cycle
        self._rig = rig
        self._epoch_ns = epoch_ns
        self._link_frames = link_frames
        self._n = len(cycle.joints)
        self._at = {row: len(cycle.header) + i * self._n for i, row in enumerate(cycle.rows)}
        self.t = 0.0  # s, of the newest record
        self._next_view = -np.inf
        self._flushed = -np.inf
        self._file = LogFile(self.path, "wb" if overwrite else "xb")
        self._context = foxglove.Context()
        self._mcap = foxglove.open_mcap(
            cast("BinaryIO", self._file),
            context=self._context,
            writer_options=MCAPWriteOptions(
                compression=MCAPCompression.Lz4,
                profile="ros2",
                chunk_size=CHUNK_BYTES,
                disable_seeking=True,
            ),
            channel_filter=for_file,
        )
        self._live: LiveServer | None = None
        facts = {"joints": json.dumps(cycle.joints), "epoch_ns": str(epoch_ns)}
        if can is not None:
            facts["buses"] = json.dumps(can.buses)
        if torque_limit is not None:
            facts["torque_limit_nm"] = json.dumps([float(limit) for limit in torque_limit])
        self._mcap.write_metadata("dftc_rt", facts)
        if versions:
            self._mcap.write_metadata("versions", dict(versions))
        for name, record in (notes or {}).items():
            self._mcap.write_metadata(name, dict(record))
        self._attach(SCENARIO, scenario.encode())
        self._attach(URDF, urdf.encode())
        for name, data in (files or {}).items():
            self._attach(name, data)
        self._cycles = self._channel(cycle.topic, cycle.schema, cycle.definition)
        self._rigs = self._channel(rig.topic, rig.schema, rig.definition) if rig else None
        self._can = self._channel(can.topic, can.schema, can.definition) if can else None
        self._events = self._channel("/events", "dftc_rt/msg/Event", cdr.EVENT_DEFINITION)
        self._states = self._channel(
            "/joint_states", "sensor_msgs/msg/JointState", cdr.JOINT_STATE_DEFINITION
        )
        if link_frames is not None:
            self._tf = self._channel("/tf", "tf2_msgs/msg/TFMessage", cdr.TF_DEFINITION)
        if urdf:
            topic = self._channel(
                "/robot_description", "std_msgs/msg/String", cdr.STRING_DEFINITION
            )
            topic.log(cdr.encode_string(urdf), log_time=epoch_ns)
            topic.close()  # viewers have another of that name
        self.flush()
        if live_port is not None:
            self._description = cdr.encode_string(urdf)
            self._descriptions = self._channel(
                "/robot_description", "std_msgs/msg/String", cdr.STRING_DEFINITION, MARK
            )
            try:
                self._live = LiveServer(self._context, live_port, live_name)
            except InputError as error:
                self.write_event(0.0, _WARNING, "recorder", str(error))

    def write_cycles(self, block: NDArray[np.float64]) -> None:
        """Log records of ``/cycle``, and what viewers need of them at 50 Hz or less.

        Args:
            block: Records, shape ``(k, size)``, of ascending t.

        Raises:
            LogError: The file cannot be written.
            EnvironmentLacksError: The disk is full.
        """
        times = self._write(self._cycles, block)
        if len(block):
            self.t = float(block[-1, 0])
        at = 0
        while (at := at + int(np.searchsorted(block[at:, 0], self._next_view))) < len(block):
            self._write_view(times[at], block[at])
            self._next_view = block[at, 0] + 1.0 / VIEW_HZ - 1e-9
        self._file.check()

    def write_rig(self, block: NDArray[np.float64]) -> None:
        """Log records of ``/rig``.

        Args:
            block: Records, shape ``(k, size)``, of ascending t.

        Raises:
            LogError: The file cannot be written, or the recorder has no rig layout.
            EnvironmentLacksError: The disk is full.
        """
        if self._rigs is None:
            raise LogError(str(self.path), "a rig record", "a recorder with a rig layout")
        self._write(self._rigs, block)
        self._file.check()

    def write_frames(self, block: NDArray[np.float64], origin: float = 0.0) -> None:
        """Log records of ``/can``.

        Args:
            block: Records, shape ``(k, size)``, their time on the clock that began at
                ``origin``.
            origin: The clock at run time 0, s.

        Raises:
            LogError: The file cannot be written, or the recorder has no layout of frames.
            EnvironmentLacksError: The disk is full.
        """
        if self._can is None:
            raise LogError(str(self.path), "a frame", "a recorder with a layout of frames")
        block = block.copy()
        block[:, 0] -= origin
        self._write(self._can, block)
        self._file.check()

    def write_event(self, t: float, severity: int, source: str, text: str) -> None:
        """Log an event.

        Args:
            t: Run time, s.
            severity: 0 debug, 1 info, 2 warning, 3 error.
            source: Process, bus or joint it is about.
            text: One line.

        Raises:
            LogError: The file cannot be written.
            EnvironmentLacksError: The disk is full.
        """
        payload = cdr.encode_event(t, severity, source, text)
        self._events.log(payload, log_time=max(0, self._epoch_ns + round(t * 1e9)))
        self._file.check()

    def flush(self) -> None:
        """End the chunk and hand it to the system (which may still lose it in a power cut).

        Raises:
            LogError: The file cannot be written.
            EnvironmentLacksError: The disk is full.
        """
        self._mcap.flush()
        self._file.check()

    def flush_due(self, now: float) -> None:
        """Flush when the last one was :data:`FLUSH_S` ago by the caller's clock, in s.

        Raises:
            LogError: The file cannot be written.
            EnvironmentLacksError: The disk is full.
        """
        self._describe()
        if now - self._flushed >= FLUSH_S:
            self._flushed = now
            self.flush()

    def _describe(self) -> None:
        """Send the robot to viewers that have come since: it is logged once, at the start."""
        if self._live is not None and self._live.subscribed:
            self._live.subscribed = False
            time = max(0, self._epoch_ns + round(self.t * 1e9))
            self._descriptions.log(self._description, log_time=time)

    def close(self) -> None:
        """Write the summary and close the file; a second call does nothing.

        Raises:
            LogError: The file cannot be written.
            EnvironmentLacksError: The disk is full.
        """
        if self._file.closed:
            return
        if self._live is not None:
            self._live.stop()
        self._mcap.close()
        self._file.close()
        self._file.check()

    def __enter__(self) -> Self:
        """The recorder itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    def _attach(self, name: str, data: bytes) -> None:
        if data:
            self._mcap.attach(
                log_time=self._epoch_ns,
                create_time=self._epoch_ns,
                name=name,
                media_type=_MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream"),
                data=data,
            )

    def _channel(
        self, topic: str, schema: str, definition: str, metadata: dict[str, str] | None = None
    ) -> foxglove.Channel:
        return foxglove.Channel(
            topic,
            schema=foxglove.Schema(name=schema, encoding="ros2msg", data=definition.encode()),
            message_encoding="cdr",
            metadata=metadata,
            context=self._context,
        )

    def _write(self, channel: foxglove.Channel, block: NDArray[np.float64]) -> list[int]:
        """Log each row; returns the log times, ns."""
        if not len(block):
            return []
        since = np.rint(block[:, 0] * 1e9).astype(np.int64)
        times: list[int] = np.maximum(since + self._epoch_ns, 0).tolist()
        log = channel.base.log
        step = 4 + 8 * block.shape[1]
        for start in range(0, len(block), _ROWS_AT_ONCE):
            part = block[start : start + _ROWS_AT_ONCE]
            raw = np.empty((len(part), step), np.uint8)
            raw[:, :4] = np.frombuffer(CDR_HEADER, np.uint8)
            raw[:, 4:] = np.ascontiguousarray(part, "<f8").view(np.uint8)
            messages: list[bytes] = raw.view(f"V{step}").ravel().tolist()
            for message, time in zip(messages, times[start:], strict=False):
                log(message, log_time=time)
        return times

    def _write_view(self, time: int, record: NDArray[np.float64]) -> None:
        def row(name: str) -> NDArray[np.float64]:
            return record[self._at[name] : self._at[name] + self._n]

        state = cdr.encode_joint_state(time, self._cycle.joints, row("q"), row("v"), row("tau_cmd"))
        self._states.log(state, log_time=time)
        if self._link_frames is not None:
            self._tf.log(cdr.encode_tf(time, self._link_frames(row("q"))), log_time=time)
