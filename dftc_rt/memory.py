"""Records kept in memory: what a simulation writes instead of a ring."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_BLOCK = 4096


class MemorySink:
    """A growing sequence of records of one width; grows by blocks, never copies."""

    def __init__(self, width: int) -> None:
        """Start empty, for records of ``width`` float64."""
        self._width = width
        self._blocks: list[F64] = []
        self._views: list[F64] = []
        self._next = _BLOCK
        self._taken = 0

    def slot(self) -> F64:
        """Return where to write the next record, (width,)."""
        if self._next == _BLOCK:
            block = np.zeros((_BLOCK, self._width))
            self._blocks.append(block)
            self._views = list(block)
            self._next = 0
        return self._views[self._next]

    def commit(self) -> bool:
        """Keep the record that was written."""
        self._next += 1
        return True

    def __len__(self) -> int:
        return (len(self._blocks) - 1) * _BLOCK + self._next if self._blocks else 0

    def records(self) -> F64:
        """Return all records, (K, width)."""
        if not self._blocks:
            return np.zeros((0, self._width))
        return np.concatenate([*self._blocks[:-1], self._blocks[-1][: self._next]])

    def drain(self) -> F64:
        """Return the records since the last drain, (k, width); those of one block at most."""
        index, offset = divmod(self._taken, _BLOCK)
        if index >= len(self._blocks):
            return np.zeros((0, self._width))
        end = self._next if index == len(self._blocks) - 1 else _BLOCK
        self._taken += end - offset
        return self._blocks[index][offset:end]
