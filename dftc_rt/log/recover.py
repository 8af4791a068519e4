"""Repairs a log whose writer was cut off: everything before the tear, in a whole file."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mcap.records import Attachment, Channel, Chunk, Header, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from dftc_rt.errors import LogError
from dftc_rt.log.chunks import DAMAGE, MAGIC, cut, records


@dataclass
class Recovered:
    """What was saved.

    Attributes:
        messages: How many.
        attachments: How many.
        metadata: How many records.
        damaged: Names of attachments that do not have their checksum, and were left out.
        whole: Whether the source had neither tear nor damage.
    """

    messages: int = 0
    attachments: int = 0
    metadata: int = 0
    damaged: list[str] = field(default_factory=list)
    whole: bool = False


def recover(src: str | Path, dst: str | Path) -> Recovered:
    """Write all that precedes the tear in ``src`` to ``dst``, which becomes a whole log.

    A chunk is saved whole or not at all: its checksum covers all of it.

    Raises:
        LogError: ``src`` cannot be read, is no MCAP file or holds nothing that can be read,
            or ``dst`` cannot be written or is ``src``, or is there and no plain file.
    """
    if os.path.exists(src) and os.path.exists(dst) and os.path.samefile(src, dst):
        raise LogError(str(dst), "the log itself", "another file to write to")
    if os.path.exists(dst) and not os.path.isfile(dst):
        # It would be replaced, not written to: as root, even a device like /dev/full.
        raise LogError(str(dst), "is no plain file", "a file to write")
    try:
        with open(src, "rb") as source:
            if source.read(len(MAGIC)) != MAGIC:
                raise LogError(str(src), "no MCAP file", "a log written by dftc")
            part = Path(dst).with_name(f".dftc-recover-{os.getpid()}")
            try:
                with open(part, "xb") as out:
                    done = _copy(source, out)
                if not (done.whole or done.messages or done.attachments or done.metadata):
                    raise LogError(str(src), "nothing in it can be read", "a log written by dftc")
                os.replace(part, dst)
            except BaseException:
                part.unlink(missing_ok=True)
                raise
            return done
    except LogError:
        raise
    except OSError as error:
        where = error.filename or str(src)
        raise LogError(str(where), error.strerror or str(error)) from None


def _copy(source: IO[bytes], out: IO[bytes]) -> Recovered:
    writer = Writer(out, chunk_size=256 * 1024, compression=CompressionType.LZ4)
    copy = _Copy(writer)
    try:
        for record in records(source, copy.done.damaged.append):
            copy.add(record)
        copy.done.whole = not copy.done.damaged
    except DAMAGE:
        pass  # the tear: what came before it has been copied
    copy.start("")
    writer.finish()  # type: ignore[no-untyped-call]
    return copy.done


class _Copy:
    """Feeds records of one file to the writer of another."""

    def __init__(self, writer: Writer) -> None:
        self.done = Recovered()
        self._writer = writer
        self._started = False
        self._schemas: dict[int, int] = {0: 0}  # id there: id here
        self._channels: dict[int, int] = {}

    def start(self, profile: str) -> None:
        if not self._started:
            self._writer.start(profile)
            self._started = True

    def add(self, record: object) -> None:
        if isinstance(record, Header):
            self.start(record.profile)
        elif isinstance(record, Chunk):
            found = cut(record)
            for inner in (*found.schemas, *found.channels):
                self.add(inner)
            for k in range(len(found.start)):
                channel, sequence, log_time, publish_time = found.head(k)
                self._message(channel, sequence, log_time, publish_time, found.payload(k))
        elif isinstance(record, Schema) and record.id not in self._schemas:
            self._schemas[record.id] = self._writer.register_schema(
                record.name, record.encoding, record.data
            )
        elif isinstance(record, Channel) and record.id not in self._channels:
            if record.schema_id not in self._schemas:
                raise ValueError("a channel without its schema")
            self._channels[record.id] = self._writer.register_channel(
                record.topic,
                record.message_encoding,
                self._schemas[record.schema_id],
                record.metadata,
            )
        elif isinstance(record, Message):
            self._message(
                record.channel_id,
                record.sequence,
                record.log_time,
                record.publish_time,
                record.data,
            )
        elif isinstance(record, Attachment):
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
            self.done.attachments += 1
        elif isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)
            self.done.metadata += 1

    def _message(self, channel: int, sequence: int, log: int, publish: int, data: bytes) -> None:
        if channel not in self._channels:
            raise ValueError("a message without its channel")
        self._writer.add_message(self._channels[channel], log, data, publish, sequence)
        self.done.messages += 1
