"""A log whose insides are wrong though every checksum in it is right."""

from __future__ import annotations

import struct
import zlib

from hypothesis import strategies as st
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream

from tests.fuzz.damage import Draw, damaged

MAGIC = b"\x89MCAP0\r\n"
_CHUNK, _ATTACHMENT, _METADATA = 0x06, 0x09, 0x0C


def records(data: bytes) -> list[tuple[int, bytes]]:
    """Opcode and content of every record of the data section and the summary."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, data[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def joined(parts: list[tuple[int, bytes]]) -> bytes:
    """The file that these records make."""
    body = b"".join(struct.pack("<BQ", opcode, len(raw)) + raw for opcode, raw in parts)
    return MAGIC + body + MAGIC


def opened(raw: bytes) -> bytes:
    """A chunk without compression."""
    start, end, size, _, name = struct.unpack_from("<QQQII", raw)
    kind = raw[32 : 32 + name].decode()
    (length,) = struct.unpack_from("<Q", raw, 32 + name)
    data = raw[40 + name : 40 + name + length]
    chunk = Chunk(kind, data, end, start, 0, size)
    stream, count = get_chunk_data_stream(chunk, validate_crc=False)
    return sealed(raw[:16], stream.read(count))


def sealed(times: bytes, data: bytes) -> bytes:
    """An uncompressed chunk with the right checksum."""
    head = times + struct.pack("<QII", len(data), zlib.crc32(data), 0)
    return head + struct.pack("<Q", len(data)) + data


def reseal(log: bytes, draw: Draw) -> bytes:
    """Damage one to three records of a log, each with its checksum made right."""
    parts = records(log)
    places = [k for k, (op, _) in enumerate(parts) if op in (_CHUNK, _ATTACHMENT, _METADATA, 3, 4)]
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.sampled_from(places))
        opcode, raw = parts[at]
        if opcode == _CHUNK:
            whole = opened(raw)
            parts[at] = opcode, sealed(whole[:16], draw(damaged(whole[40:], 3)))
        elif opcode == _ATTACHMENT:
            inside = draw(damaged(raw[:-4], 3))
            parts[at] = opcode, inside + struct.pack("<I", zlib.crc32(inside))
        else:
            parts[at] = opcode, draw(damaged(raw, 3))
    return joined(parts)
