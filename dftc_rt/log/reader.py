"""Reads a log into arrays."""

from __future__ import annotations

import json
import os
import re
import struct
from dataclasses import dataclass, field
from pathlib import Path
from types import UnionType
from typing import IO, Any, Final

import numpy as np
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from numpy.typing import NDArray

from dftc_rt.bus.frame_record import record_dtype
from dftc_rt.errors import LogError
from dftc_rt.log.cdr import decode_event
from dftc_rt.log.chunks import DAMAGE, MAGIC, Cut, cut, records
from dftc_rt.log.run import CanFrames, Run, Signals, split
from dftc_rt.log.schema import (
    CDR_HEADER,
    CYCLE_HEADER,
    RIG_HEADER,
    RIG_ROWS,
    SCENARIO,
    URDF,
    CanLayout,
    Layout,
    field_name,
)
from dftc_rt.ring import Event

_FIXED: Final = ("/cycle", "/rig")
_EVENTS: Final = "/events"
_OURS: Final = "as written by dftc"
_RELIED_ON: Final = {
    "/cycle": (CYCLE_HEADER, ("q", "v", "qd", "vd", "tau_cmd", "rho_hat", "verdict", "status")),
    "/rig": (RIG_HEADER, RIG_ROWS),
}
_ROWS: Final = 16384  # to begin with


def read(path: str | Path, *, torn: bool = False, frames: bool = False) -> Run:
    """The run that a log holds.

    Args:
        path: The log.
        torn: Take what comes before a tear or damage, instead of refusing the log.
        frames: Read ``/can`` too, if the log has it.

    Raises:
        LogError: Missing, foreign, torn (says how to repair it), damaged, or no ``/cycle``.
    """
    found = read_piece(path, torn=torn, frames=frames)
    if not found.cycle:
        raise LogError(str(path), "no topic /cycle", "a log written by dftc")
    return found


def read_piece(path: str | Path, *, torn: bool = False, frames: bool = False) -> Run:
    """What a file holds of a run, which may be the truth alone: then ``cycle`` has no fields.

    A recorder that takes over when the controller has gone has nothing else to write.

    Args:
        path: The file.
        torn: As in :func:`read`.
        frames: As in :func:`read`.

    Raises:
        LogError: As in :func:`read`; or neither ``/cycle`` nor ``/rig``.
    """
    where = str(path)
    content = _Content((*_FIXED, CanLayout.topic) if frames else _FIXED)
    try:
        with open(path, "rb") as stream:
            _check_start(where, stream)
            if not torn and not _has_end(stream):
                raise LogError(
                    where,
                    "torn, its writer was cut off",
                    f"a whole log; dftc recover {where} -o F.mcap",
                )
            for record in records(stream):
                content.add(record)
    except LogError:
        raise
    except OSError as error:
        raise LogError(where, error.strerror or str(error), "a log that can be read") from None
    except DAMAGE:
        if not torn:
            raise LogError(
                where, "damaged", f"a whole log; dftc recover {where} -o F.mcap saves what it can"
            ) from None
    return content.run(where)


def is_torn(path: str | Path) -> bool:
    """Whether a log's writer was cut off.

    Raises:
        OSError: It cannot be read.
    """
    with open(path, "rb") as stream:
        return not _has_end(stream)


def _check_start(where: str, stream: IO[bytes]) -> None:
    if stream.read(len(MAGIC)) != MAGIC:
        raise LogError(where, "no MCAP file", "a log written by dftc")


def _has_end(stream: IO[bytes]) -> bool:
    end = stream.seek(0, os.SEEK_END) - len(MAGIC)
    if end < len(MAGIC):
        return False
    stream.seek(end)
    return stream.read() == MAGIC


class _Rows:
    """Payloads of one length side by side, behind their CDR header.

    One block that doubles: many small ones cost more in fresh memory than the reading itself.

    Attributes:
        count: How many there are.
        uneven: There was one of another length; only those before it are here.
    """

    def __init__(self) -> None:
        self.count = 0
        self.uneven = False
        self._block = np.empty((0, 0), np.uint8)

    def take(self, found: Cut, which: NDArray[np.int64]) -> None:
        size = found.size[which]
        step = int(size[0]) - len(CDR_HEADER)
        if not self.count and step > 0:
            self._block = np.empty((_ROWS, step), np.uint8)
        if step != self._block.shape[1] or (size != size[0]).any():
            self.uneven = True
            return
        end = self.count + len(which)
        if end > len(self._block):
            grown = np.empty((max(end, 2 * len(self._block)), step), np.uint8)
            grown[: self.count] = self._block[: self.count]
            self._block = grown
        found.gather(which, len(CDR_HEADER), self._block[self.count : end])
        self.count = end

    def block(self, where: str, step: int) -> NDArray[np.uint8]:
        """All of them, shape ``(count, step)``.

        Raises:
            LogError: One has another length.
        """
        if self.uneven or (self.count and self._block.shape[1] != step):
            expected = f"{len(CDR_HEADER) + step} bytes"
            raise LogError(where, "a message of another length", expected)
        return self._block[: self.count] if self.count else np.empty((0, step), np.uint8)


@dataclass
class _Topic:
    """The messages of one topic.

    Attributes:
        schema: Number of its schema.
        rows: Those of a topic of fixed length.
        payloads: Those of any length, one by one.
    """

    schema: int
    rows: _Rows = field(default_factory=_Rows)
    payloads: list[bytes] = field(default_factory=list)


@dataclass
class _Content:
    """What has been read so far.

    Attributes:
        fixed: Topics whose messages have one length.
    """

    fixed: tuple[str, ...]
    schemas: dict[int, Schema] = field(default_factory=dict)
    topics: dict[str, _Topic] = field(default_factory=dict)
    numbers: dict[int, str] = field(default_factory=dict)  # channel: topic
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)

    def add(self, record: object) -> None:
        if isinstance(record, Chunk):
            found = cut(record)
            for inner in (*found.schemas, *found.channels):
                self.add(inner)
            for number, name in self.numbers.items():
                which = np.flatnonzero(found.channel == number)
                if len(which):
                    self._take(name, found, which)
        elif isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            if record.topic in (*self.fixed, _EVENTS) and record.id not in self.numbers:
                self.numbers[record.id] = record.topic
                self.topics[record.topic] = _Topic(record.schema_id)
        elif isinstance(record, Attachment):
            self.attachments[record.name] = record.data
        elif isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata

    def _take(self, name: str, found: Cut, which: NDArray[np.int64]) -> None:
        topic = self.topics[name]
        if name == _EVENTS:
            topic.payloads += [found.payload(k) for k in which.tolist()]
            return
        topic.rows.take(found, which)

    def run(self, where: str) -> Run:
        cycle, rig = self._signals(where, "/cycle"), self._signals(where, "/rig")
        known = cycle or rig
        if known is None:
            raise LogError(where, "no topic /cycle", "a log written by dftc")
        joints = known[0]
        told = self.topics.get(_EVENTS)
        try:
            events = [Event(*decode_event(raw)) for raw in told.payloads] if told else []
        except (struct.error, UnicodeDecodeError):
            raise LogError(f"{where} {_EVENTS}", "damaged", _OURS) from None
        if not re.fullmatch("[0-9]{1,20}", epoch := self._facts.get("epoch_ns", "0")):
            raise LogError(where, f"its epoch_ns is '{epoch}'", _OURS)
        limits = self._listed(where, "torque_limit_nm", int | float)
        if limits is not None and len(limits) != len(joints):
            raise LogError(where, f"torque limits of {len(limits)} joints", f"{len(joints)}")
        return Run(
            joints,
            cycle[1] if cycle else {},
            rig[1] if rig else None,
            tuple(sorted(events, key=lambda event: event.t)),
            self._text(where, SCENARIO),
            self._text(where, URDF),
            limits,
            self.metadata,
            self._frames(where),
            {n: data for n, data in self.attachments.items() if n not in (SCENARIO, URDF)},
        )

    @property
    def _facts(self) -> dict[str, str]:
        return self.metadata.get("dftc_rt", {})

    def _text(self, where: str, name: str) -> str:
        try:
            return self.attachments.get(name, b"").decode()
        except UnicodeDecodeError:
            raise LogError(where, f"attachment {name} is no text", _OURS) from None

    def _listed(self, where: str, key: str, kind: UnionType | type) -> tuple[Any, ...] | None:
        """A list out of the metadata; None where it is not there."""
        text = self._facts.get(key)
        if not text:
            return None
        try:
            found = json.loads(text)
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, list) or not all(isinstance(item, kind) for item in found):
            raise LogError(where, f"its {key} is '{text}'", _OURS)
        return tuple(found)

    def _definition(self, topic: _Topic) -> list[str]:
        schema = self.schemas.get(topic.schema)
        return schema.data.decode(errors="replace").splitlines() if schema else []

    def _signals(self, where: str, name: str) -> tuple[tuple[str, ...], Signals] | None:
        topic = self.topics.get(name)
        if topic is None:
            return None
        lines = self._definition(topic)
        fields = [line.split()[1] for line in lines if re.match(r"float64 +[^ ]", line)]
        layout = _layout(name, fields, self._joint_names(where, fields))
        if layout is None:
            raise LogError(f"{where} {name}", "fields of another program", "as written by dftc")
        block = topic.rows.block(f"{where} {name}", 8 * len(fields))
        if not _complete(layout):
            raise LogError(f"{where} {name}", "lacks fields", _OURS)
        return layout.joints, split(layout, block.view("<f8").astype(np.float64, copy=False))

    def _frames(self, where: str) -> CanFrames | None:
        topic = self.topics.get(CanLayout.topic)
        if topic is None:
            return None
        where = f"{where} {CanLayout.topic}"
        buses = self._listed(where, "buses", str) or ()
        lines = self._definition(topic)
        for layout in (CanLayout(buses, size) for size in (8, 64)):
            if layout.definition.splitlines() == lines:
                dtype = record_dtype(layout.data_bytes)
                block = topic.rows.block(where, dtype.itemsize)
                return CanFrames(buses, block.view(dtype)[:, 0])
        raise LogError(where, "fields of another program", "as written by dftc")

    def _joint_names(self, where: str, fields: list[str]) -> tuple[str, ...]:
        """As the robot has them; from the fields when another tool dropped the metadata."""
        names = self._listed(where, "joints", str)
        if names is not None:
            return names
        return tuple(name[2:] for name in fields if name.startswith("q_"))


def _complete(layout: Layout) -> bool:
    """Whether all is there that everybody who reads a run relies on."""
    header, rows = _RELIED_ON[layout.topic]
    return layout.header == header and set(rows) <= set(layout.rows)


def _layout(topic: str, fields: list[str], joints: tuple[str, ...]) -> Layout | None:
    """The layout whose fields these are; None when there is none."""
    if not joints or "q_" + field_name(joints[0]) not in fields:
        return None
    header = fields.index("q_" + field_name(joints[0]))
    tail = "_" + field_name(joints[0])
    rows = tuple(name.removesuffix(tail) for name in fields[header :: len(joints)])
    layout = Layout(topic, "", tuple(fields[:header]), rows, joints)
    return layout if list(layout.fields) == fields else None
