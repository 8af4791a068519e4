"""Reads the records of an MCAP file in order, whole chunks at a time.

The mcap library parses the records; only where each is, and the messages inside a chunk, are
found here: an index entry and a Python object for each of 120,000 messages take longer than
all the rest.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import IO, Final

import numba
import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, McapRecord, Schema
from mcap.stream_reader import CRCValidationError, StreamReader, get_chunk_data_stream
from numpy.typing import NDArray

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
_MESSAGE_BYTES: Final = _MESSAGE.size
_LEAST_BYTES: Final = 23  # of a record in a chunk: an empty schema
_BYTES: Final = numba.types.Array(numba.uint8, 1, "C", readonly=True)
_READ: Final = frozenset(
    (
        Opcode.HEADER, Opcode.FOOTER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK,
        Opcode.ATTACHMENT, Opcode.METADATA,
    )
)  # fmt: skip


def records(
    stream: IO[bytes], damaged: Callable[[str], object] | None = None
) -> Iterator[McapRecord]:
    """The file's records, with chunks left closed; indices and the summary's are left out.

    Args:
        stream: The file.
        damaged: Called with the name of an attachment that does not have its checksum, which
            is then left out; None: it is damage like any other.

    Raises:
        One of :data:`DAMAGE`, where the file ends early or is damaged.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    _magic(stream)
    while True:
        head = stream.read(_RECORD.size)
        opcode, length = _RECORD.unpack(head)
        if length > size - stream.tell():
            raise EOFError(f"a record of {length} bytes beyond the end")
        if opcode == 0:
            raise ValueError("a record of no kind")
        if opcode not in _READ:
            stream.seek(length, os.SEEK_CUR)
            continue
        raw = stream.read(length)
        record = _parse(head + raw)
        if isinstance(record, Attachment) and not _intact(raw):
            if damaged is None:
                raise ValueError(f"the attachment {record.name} is damaged")
            damaged(record.name)
            continue
        yield record
        if isinstance(record, Footer):
            _magic(stream)
            return


def _magic(stream: IO[bytes]) -> None:
    if stream.read(len(MAGIC)) != MAGIC:
        raise ValueError("no MCAP file, or one that goes on behind its end")


def _intact(attachment: bytes) -> bool:
    """Whether an attachment has its checksum, which the mcap library does not look at."""
    (expected,) = struct.unpack_from("<I", attachment, len(attachment) - 4)
    return not expected or zlib.crc32(attachment[:-4]) == expected


@dataclass(frozen=True)
class Cut:
    """Where everything in a chunk is.

    Attributes:
        schemas: Its schemas.
        channels: Its channels.
        data: The chunk, uint8.
        start: Where the payload of each message begins, (k,).
        size: Bytes of the payload, (k,).
        channel: Channel of the message, (k,).
    """

    schemas: list[Schema]
    channels: list[Channel]
    data: NDArray[np.uint8]
    start: NDArray[np.int64]
    size: NDArray[np.int64]
    channel: NDArray[np.int64]

    def head(self, k: int) -> tuple[int, int, int, int]:
        """Channel, sequence, log time and publish time, ns, of message k."""
        return _MESSAGE.unpack_from(self.data.data, self.start[k] - _MESSAGE_BYTES)

    def payload(self, k: int) -> bytes:
        """Payload of message k."""
        return self.data[self.start[k] : self.start[k] + self.size[k]].tobytes()

    def gather(self, which: NDArray[np.int64], skip: int, out: NDArray[np.uint8]) -> None:
        """Copy payloads side by side, without their first bytes.

        Args:
            which: Numbers of the messages, (m,), of one size.
            skip: Bytes to leave out at the start of each.
            out: Where to, C-contiguous, (m, size - skip).
        """
        _gather(self.data, self.start[which] + skip, out)


@numba.njit(numba.int64(_BYTES, numba.int64[:, ::1]), cache=True)
def _find(data: NDArray[np.uint8], found: NDArray[np.int64]) -> int:
    """Fill in start, size and channel of every record; return how many, -1 when damaged.

    A schema or a channel is told by its opcode, negative, and its start by its own header.
    """
    at, count, end = 0, 0, data.shape[0]
    while at < end:
        if end - at < 9 or count == found.shape[1]:
            return -1
        opcode, size = data[at], np.int64(0)
        for i in range(8):
            size |= np.int64(data[at + 1 + i]) << (8 * i)
        at += 9
        if size < 0 or size > end - at:
            return -1
        if opcode == 5:
            if size < 22:
                return -1
            found[0, count] = at + 22
            found[1, count] = size - 22
            found[2, count] = np.int64(data[at]) | np.int64(data[at + 1]) << 8
            count += 1
        elif opcode in (3, 4):
            found[0, count] = at - 9
            found[1, count] = size + 9
            found[2, count] = -np.int64(opcode)
            count += 1
        at = at + int(size)
    return count


@numba.njit(numba.void(_BYTES, numba.int64[::1], numba.uint8[:, ::1]), cache=True)
def _gather(data: NDArray[np.uint8], start: NDArray[np.int64], out: NDArray[np.uint8]) -> None:
    for k in range(out.shape[0]):
        out[k] = data[start[k] : start[k] + out.shape[1]]


def cut(chunk: Chunk) -> Cut:
    """Decompress and check a chunk, and find what it holds.

    Raises:
        One of :data:`DAMAGE`, where the chunk is damaged.
    """
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    raw = stream.read(length) if length else b""
    if length != chunk.uncompressed_size:
        raise EOFError(f"chunk of {length} bytes instead of {chunk.uncompressed_size}")
    data = np.frombuffer(raw, np.uint8)
    found = np.empty((3, length // _LEAST_BYTES + 1), np.int64)
    count = _find(data, found)
    if count < 0:
        raise ValueError("a chunk whose records do not fit it")
    start, size, channel = found[:, :count]
    schemas: list[Schema] = []
    channels: list[Channel] = []
    for k in np.flatnonzero(channel < 0).tolist():
        record = _parse(raw[start[k] : start[k] + size[k]])
        if isinstance(record, Schema):
            schemas.append(record)
        elif isinstance(record, Channel):
            channels.append(record)
    messages = channel >= 0
    return Cut(schemas, channels, data, start[messages], size[messages], channel[messages])


def _parse(raw: bytes) -> McapRecord:
    return next(iter(StreamReader(BytesIO(raw), skip_magic=True, emit_chunks=True).records))
