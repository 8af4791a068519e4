"""Reads the records of an MCAP file in order, whole chunks at a time.

The mcap library parses the records; only the messages inside a chunk are cut out here,
because a Python object for each of 120,000 messages takes longer than all the rest.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from io import BytesIO
from typing import IO, Final

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Schema
from mcap.stream_reader import CRCValidationError, StreamReader, get_chunk_data_stream

MAGIC: Final = b"\x89MCAP0\r\n"

DAMAGE: Final = (
    McapError,
    CRCValidationError,
    struct.error,
    UnicodeDecodeError,
    RuntimeError,  # lz4
    EOFError,
    OverflowError,
    MemoryError,  # a length made of noise
    ValueError,
)
"""What the mcap library, lz4 and struct raise on a torn or damaged file."""

_RECORD: Final = struct.Struct("<BQ")  # opcode, length
_MESSAGE: Final = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time

CutMessage = tuple[int, int, int, int, bytes]
"""Channel id, sequence, log time ns, publish time ns, payload."""


def records(stream: IO[bytes]) -> Iterator[McapRecord]:
    """The file's records, with chunks left closed.

    Raises:
        One of :data:`DAMAGE`, where the file ends early or is damaged.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    yield from StreamReader(stream, emit_chunks=True, record_size_limit=size).records


def open_chunk(chunk: Chunk) -> tuple[list[Schema], list[Channel], list[CutMessage]]:
    """Decompress and check a chunk, and cut it into what it holds.

    Raises:
        One of :data:`DAMAGE`, where the chunk is damaged.
    """
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    data = stream.read(length) if length else b""
    if length != chunk.uncompressed_size:
        raise EOFError(f"chunk of {length} bytes instead of {chunk.uncompressed_size}")
    schemas: list[Schema] = []
    channels: list[Channel] = []
    messages: list[CutMessage] = []
    at = 0
    while at < length:
        opcode, size = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        end = at + size
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, at)
            payload = data[at + _MESSAGE.size : end]
            messages.append((channel, sequence, log_time, publish_time, payload))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            record = _parse(data[at - _RECORD.size : end])
            if isinstance(record, Schema):
                schemas.append(record)
            elif isinstance(record, Channel):
                channels.append(record)
        at = end
    return schemas, channels, messages


def _parse(raw: bytes) -> McapRecord:
    return next(iter(StreamReader(BytesIO(raw), skip_magic=True).records))
