"""Reads a log into arrays."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Final

import numpy as np
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from numpy.typing import NDArray

from dftc_rt.errors import LogError
from dftc_rt.log.cdr import decode_event
from dftc_rt.log.chunks import DAMAGE, MAGIC, open_chunk, records
from dftc_rt.log.run import Run, Signals, split
from dftc_rt.log.schema import CDR_HEADER, SCENARIO, URDF, Layout, field_name
from dftc_rt.ring import Event

_TOPICS: Final = ("/cycle", "/rig", "/events")


def read(path: str | Path, *, torn: bool = False) -> Run:
    """The run that a log holds.

    Args:
        path: The log.
        torn: Take what comes before a tear or damage, instead of refusing the log.

    Raises:
        LogError: Missing, foreign, torn (says how to repair it), damaged, or no ``/cycle``.
    """
    where = str(path)
    content = _Content()
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


@dataclass
class _Content:
    """What has been read so far."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    topics: dict[str, Channel] = field(default_factory=dict)
    wanted: dict[int, list[bytes]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)

    def add(self, record: object) -> None:
        if isinstance(record, Chunk):
            schemas, channels, messages = open_chunk(record)
            for inner in (*schemas, *channels):
                self.add(inner)
            wanted = self.wanted
            for channel, _, _, _, payload in messages:
                if channel in wanted:
                    wanted[channel].append(payload)
        elif isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            if record.topic in _TOPICS and record.id not in self.wanted:
                self.topics[record.topic] = record
                self.wanted[record.id] = []
        elif isinstance(record, Attachment):
            self.attachments[record.name] = record.data
        elif isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata

    def run(self, where: str) -> Run:
        cycle = self._signals(where, "/cycle")
        if cycle is None:
            raise LogError(where, "no topic /cycle", "a log written by dftc")
        joints, signals = cycle
        rig = self._signals(where, "/rig")
        events = [Event(*decode_event(raw)) for raw in self._payloads("/events")]
        limits = self.metadata.get("dftc_rt", {}).get("torque_limit_nm")
        return Run(
            joints,
            signals,
            rig[1] if rig else None,
            tuple(sorted(events, key=lambda event: event.t)),
            self.attachments.get(SCENARIO, b"").decode(),
            self.attachments.get(URDF, b"").decode(),
            tuple(json.loads(limits)) if limits else None,
            self.metadata,
            {n: data for n, data in self.attachments.items() if n not in (SCENARIO, URDF)},
        )

    def _payloads(self, topic: str) -> list[bytes]:
        channel = self.topics.get(topic)
        return self.wanted[channel.id] if channel else []

    def _signals(self, where: str, topic: str) -> tuple[tuple[str, ...], Signals] | None:
        channel = self.topics.get(topic)
        if channel is None:
            return None
        schema = self.schemas.get(channel.schema_id)
        lines = schema.data.decode().splitlines() if schema else []
        fields = [line.split()[1] for line in lines if line.startswith("float64 ")]
        layout = _layout(topic, fields, self._joint_names(fields))
        if layout is None:
            raise LogError(f"{where} {topic}", "fields of another program", "as written by dftc")
        return layout.joints, split(layout, _matrix(where, topic, self._payloads(topic), fields))

    def _joint_names(self, fields: list[str]) -> tuple[str, ...]:
        """As the robot has them; from the fields when another tool dropped the metadata."""
        text = self.metadata.get("dftc_rt", {}).get("joints")
        if text is not None:
            return tuple(json.loads(text))
        return tuple(name[2:] for name in fields if name.startswith("q_"))


def _layout(topic: str, fields: list[str], joints: tuple[str, ...]) -> Layout | None:
    """The layout whose fields these are; None when there is none."""
    if not joints or "q_" + field_name(joints[0]) not in fields:
        return None
    header = fields.index("q_" + field_name(joints[0]))
    tail = "_" + field_name(joints[0])
    rows = tuple(name.removesuffix(tail) for name in fields[header :: len(joints)])
    layout = Layout(topic, "", tuple(fields[:header]), rows, joints)
    return layout if list(layout.fields) == fields else None


def _matrix(
    where: str, topic: str, payloads: Iterable[bytes], fields: list[str]
) -> NDArray[np.float64]:
    """Payloads side by side, shape ``(K, size)``."""
    raw = np.frombuffer(b"".join(payloads), np.uint8)
    step = len(CDR_HEADER) + 8 * len(fields)
    if len(raw) % step:
        raise LogError(f"{where} {topic}", "a message of another length", f"{step} bytes")
    body = np.ascontiguousarray(raw.reshape(-1, step)[:, len(CDR_HEADER) :])
    return body.view("<f8").astype(np.float64, copy=False)
