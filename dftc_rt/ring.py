"""Rings in shared memory: one writer, one reader, no lock, and the writer never waits.

A ring lives in a memfd segment that is passed on by descriptor, so no name is left
behind and the memory goes with the last descriptor, however its holders died. What was
committed stays readable after the writer was killed, and a reader that was killed is
replaced by another that goes on at the same place: both counters are in the segment.

Ordering: the writer stores a slot and then the counter, the reader loads the counter and
then the slot, with no barrier between them. That relies on x86's total store order; on a
weaker memory model a reader could see a counter before the slot that it announces.

Layout of the segment, in native uint64 (a cache line per owner):

    0 magic | slot bytes | slots     8 written | dropped | closed | started | origin     16 read
    4096 ... the slots
"""

from __future__ import annotations

import fcntl
import mmap
import os
import struct
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from dftc_rt.errors import EnvironmentLacksError, InputError

_MAGIC: Final = 0x3130474E49525444  # "DTRING01"
_SLOT_BYTES, _SLOTS = 1, 2
_WRITTEN, _DROPPED, _CLOSED, _STARTED, _ORIGIN = 8, 9, 10, 11, 12
_READ: Final = 16
_HEADER_BYTES: Final = 4096
_EVENT_BYTES: Final = 512
_EVENT_HEAD: Final = struct.Struct("<dIHH")  # t, severity, bytes of source, bytes of text


class _Segment:
    """The mapped memory and its counters; what float and event rings share."""

    def __init__(self, fd: int) -> None:
        """Map the segment behind ``fd`` (kept open; see :meth:`close`).

        Raises:
            InputError: ``fd`` is no ring.
        """
        self.fd = fd
        size = os.fstat(fd).st_size
        if size <= _HEADER_BYTES:
            raise InputError(f"descriptor {fd}", f"{size} bytes", "a ring")
        flags = mmap.MAP_SHARED | mmap.MAP_POPULATE  # no page fault later, in the loop
        self._map = mmap.mmap(fd, size, flags=flags)
        self._head = memoryview(self._map)[:_HEADER_BYTES].cast("Q")
        if self._head[0] != _MAGIC:
            raise InputError(f"descriptor {fd}", "another kind of memory", "a ring")
        self.slots = self._head[_SLOTS]
        self.slot_bytes = self._head[_SLOT_BYTES]

    @classmethod
    def _allocate(cls, name: str, slots: int, slot_bytes: int) -> int:
        if slots < 2 or slot_bytes < 8:
            raise InputError(f"ring {name}", f"{slots} slots of {slot_bytes} bytes", "2 or more")
        if not hasattr(os, "memfd_create"):
            raise EnvironmentLacksError("this system has no memfd_create", "run on Linux")
        fd = os.memfd_create(name, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(fd, _HEADER_BYTES + slots * slot_bytes)
        seals = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, seals)  # no holder can cut another's memory off
        os.pwrite(fd, struct.pack("=3Q", _MAGIC, slot_bytes, slots), 0)
        os.set_inheritable(fd, True)
        return fd

    @classmethod
    def attach(cls, fd: int) -> Self:
        """The ring behind an inherited descriptor.

        Raises:
            InputError: ``fd`` is no ring.
        """
        return cls(fd)

    @property
    def written(self) -> int:
        """Records committed since the ring was made."""
        return self._head[_WRITTEN]

    @property
    def dropped(self) -> int:
        """Records the writer had to give up because the ring was full."""
        return self._head[_DROPPED]

    @property
    def pending(self) -> int:
        """Records committed and not yet released by the reader."""
        return self._head[_WRITTEN] - self._head[_READ]

    @property
    def closed(self) -> bool:
        """Whether the writer has said that nothing more will come."""
        return bool(self._head[_CLOSED])

    @property
    def finished(self) -> bool:
        """Whether the writer has closed and the reader has everything."""
        return self.closed and self.pending == 0

    def end(self) -> None:
        """Writer (or who buries it): nothing more will come."""
        self._head[_CLOSED] = 1

    def advance(self, count: int) -> None:
        """Reader: release the ``count`` oldest records; their slots are written anew."""
        self._head[_READ] += count

    def close(self) -> None:
        """Close this process's descriptor; views in use stay valid."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


class Ring(_Segment):
    """Ring of float64 records of one fixed width.

    Writer: ``ring.slot()[:] = record; ring.commit()``.
    Reader: ``while len(block := ring.drain()): use(block); ring.advance(len(block))``.
    """

    def __init__(self, fd: int) -> None:
        """Map the ring behind ``fd``; see :meth:`attach` and :meth:`create`."""
        super().__init__(fd)
        self.width = self.slot_bytes // 8
        flat = np.frombuffer(self._map, np.float64, self.slots * self.width, _HEADER_BYTES)
        self._records: NDArray[np.float64] = flat.reshape(self.slots, self.width)
        self._views = list(self._records)
        self._scratch: NDArray[np.float64] = np.zeros(self.width)
        self._full = False  # the slot last given out is the scratch slot

    @classmethod
    def create(cls, name: str, slots: int, width: int) -> Ring:
        """A new ring of ``slots`` records of ``width`` float64 each.

        Args:
            name: Shown in ``/proc/<pid>/maps``; no key to anything.
            slots: Records it holds; at 1 kHz, 4096 outlast a reader's stall of 4 s.
            width: Float64 per record.

        Raises:
            InputError: Fewer than two slots, or an empty record.
            EnvironmentLacksError: Not on Linux.
        """
        return cls(cls._allocate(name, slots, 8 * width))

    def slot(self) -> NDArray[np.float64]:
        """Writer: where to write the next record, shape ``(width,)``. Real-time safe.

        When the ring is full this is a scratch slot, and :meth:`commit` counts a drop.
        """
        written = self._head[_WRITTEN]
        self._full = written - self._head[_READ] >= self.slots
        return self._scratch if self._full else self._views[written % self.slots]

    def commit(self) -> bool:
        """Writer: hand over the slot last given out. Real-time safe.

        Returns:
            False when it was the scratch slot: the record is dropped and counted.
        """
        if self._full:
            self._head[_DROPPED] += 1
            return False
        self._head[_WRITTEN] += 1
        return True

    def put(self, block: NDArray[np.float64], count: int) -> int:
        """Writer: add several records at once. Real-time safe.

        Args:
            block: Records, shape ``(>= count, width)``.
            count: How many of them.

        Returns:
            How many found room; the rest is dropped and counted.
        """
        head, slots = self._head, self.slots
        written = head[_WRITTEN]
        kept = min(count, slots - (written - head[_READ]))
        first = written % slots
        straight = min(kept, slots - first)
        self._records[first : first + straight] = block[:straight]
        if straight < kept:
            self._records[: kept - straight] = block[straight:kept]
        head[_WRITTEN] = written + kept
        head[_DROPPED] += count - kept
        return kept

    def start(self, origin: int) -> None:
        """Writer: say when run time began, for records that carry the clock's. Real-time safe.

        Args:
            origin: The clock at run time 0, ns.
        """
        self._head[_ORIGIN] = origin
        self._head[_STARTED] = 1

    @property
    def origin(self) -> int | None:
        """The clock at run time 0, ns; None until the writer has said so."""
        return self._head[_ORIGIN] if self._head[_STARTED] else None

    def drain(self, limit: int | None = None) -> NDArray[np.float64]:
        """Reader: the oldest records that lie together, without a copy.

        Args:
            limit: At most so many (None: all).

        Returns:
            View of shape ``(k, width)``, valid until :meth:`advance`; empty when there is
            nothing. At the end of the memory it ends early: ask again after advancing.
        """
        read = self._head[_READ]
        first = read % self.slots
        count = min(self._head[_WRITTEN] - read, self.slots - first)
        if limit is not None:
            count = min(count, limit)
        return self._records[first : first + count]

    def latest(self) -> NDArray[np.float64] | None:
        """Anybody: a copy of the newest record, shape ``(width,)``; None before the first.

        The writer is not stopped for it: when it laps the copy, the copy is made again.
        """
        while (written := self._head[_WRITTEN]) > 0:
            copy = self._views[(written - 1) % self.slots].copy()
            if self._head[_WRITTEN] < written - 1 + self.slots:
                return copy
        return None


class Event(NamedTuple):
    """Something that happened: a change of state, an alarm, an overrun, a bus fault."""

    t: float  # s, run time
    severity: int  # 0 debug, 1 info, 2 warning, 3 error
    source: str
    text: str


class EventRing(_Segment):
    """Ring of :class:`Event`, in fixed slots of 512 bytes; long texts are cut to fit."""

    @classmethod
    def create(cls, name: str, slots: int = 1024) -> EventRing:
        """A new ring of ``slots`` events.

        Raises:
            InputError: Fewer than two slots.
            EnvironmentLacksError: Not on Linux.
        """
        return cls(cls._allocate(name, slots, _EVENT_BYTES))

    def write(self, t: float, severity: int, source: str, text: str) -> bool:
        """Writer: add an event; False when the ring was full and it was dropped.

        Args:
            t: Run time, s.
            severity: 0 debug, 1 info, 2 warning, 3 error.
            source: Process, bus or joint it is about; at most 64 bytes of it are kept.
            text: One line.
        """
        head = self._head
        written = head[_WRITTEN]
        if written - head[_READ] >= self.slots:
            head[_DROPPED] += 1
            return False
        who = _cut(source, 64)
        what = _cut(text, _EVENT_BYTES - _EVENT_HEAD.size - len(who))
        at = _HEADER_BYTES + written % self.slots * _EVENT_BYTES
        _EVENT_HEAD.pack_into(self._map, at, t, severity, len(who), len(what))
        at += _EVENT_HEAD.size
        self._map[at : at + len(who) + len(what)] = who + what
        head[_WRITTEN] = written + 1
        return True

    def drain(self, limit: int | None = None) -> list[Event]:
        """Reader: the oldest events (copies), at most ``limit``; then call :meth:`advance`."""
        read = self._head[_READ]
        count = self._head[_WRITTEN] - read
        if limit is not None:
            count = min(count, limit)
        return [self._event(index) for index in range(read, read + count)]

    def _event(self, index: int) -> Event:
        at = _HEADER_BYTES + index % self.slots * _EVENT_BYTES
        t, severity, who, what = _EVENT_HEAD.unpack_from(self._map, at)
        at += _EVENT_HEAD.size
        source = self._map[at : at + who].decode()
        text = self._map[at + who : at + who + what].decode()
        return Event(t, severity, source, text)


def _cut(text: str, limit: int) -> bytes:
    """UTF-8 of ``text``, at most ``limit`` bytes, never in the middle of a character."""
    raw = text.encode(errors="replace")
    return raw[:limit].decode(errors="ignore").encode() if len(raw) > limit else raw
