"""What stands in for drives and clock when a log is replayed."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.drives.interface import DriveCycle
from dftc_rt.log.run import Signals
from dftc_rt.replay.causes import Causes
from dftc_rt.rt.drive_link import DriveLink

F64 = NDArray[np.float64]

_GENERIC: Final = 0x1000  # CiA 301's generic error: which one it was does not matter here


class EndOfLog(Exception):
    """The log holds no more cycles that follow on the last one."""


class LogClock:
    """The executor's clock: as late at the end of a cycle as the log says that it was.

    Attributes:
        time: ns.
    """

    lockstep = False

    def __init__(self) -> None:
        self.time = 0

    def now(self) -> int:
        """Return the time, ns."""
        return self.time

    def sleep_until(self, deadline: int) -> None:
        """Return at once."""


class LoggedLink(DriveLink):
    """Drives whose answers are those of a log; they obey nothing, they have done so already.

    Attributes:
        at: Row of the log of the present cycle.
    """

    def __init__(
        self,
        cycle: DriveCycle,
        log: Signals,
        period_ns: int,
        clock: LogClock,
        outside: Causes,
        torque_limit: F64,
    ) -> None:
        """Prepare.

        Args:
            cycle: The profile's cyclic half: it limits and quantises what is commanded.
            log: Rows of ``/cycle``, from the first cycle of the run on.
            period_ns: Control period, ns.
            clock: Told how late each cycle ends.
            outside: What is wrong with buses and drives, beside what the rows hold.
            torque_limit: Largest torque that can be commanded, (n,), Nm.
        """
        super().__init__(
            [], cycle, clock, 0.0, lambda source, text: None, torque_limit=torque_limit
        )
        self._outside = outside
        self._log = log
        self._period_ns = period_ns
        self._log_clock = clock
        self._numbers = numbers(log["t"], period_ns)
        self.at = -1

    def start_logged(self) -> None:
        """Begin from the pose at which the run began: while the drives arm, it is held."""
        self.q[:] = self._log["qd"][0]
        self.v[:] = 0.0  # as every profile starts
        self.age[:] = 0.0

    def exchange(self, number: int, deadline: int) -> None:
        """Take the answers of this cycle from the log.

        Raises:
            EndOfLog: The log does not hold this cycle.
        """
        self.at += 1
        if self.at >= len(self._numbers) or self._numbers[self.at] != number:
            self.at -= 1
            raise EndOfLog
        log, at = self._log, self.at
        self.q[:], self.v[:] = log["q"][at], log["v"][at]
        self.age[:] = log["age"][at]
        self.status[:] = log["status"][at].astype(np.int64)
        self.missed += int(np.count_nonzero(self.age))
        self.fault = self.fault or self._outside.faults.get(number, "")
        if number in self._outside.emergencies:
            self.emergency[self._outside.emergencies[number]] = _GENERIC
        self._log_clock.time = deadline + self._period_ns + self._late_ns()

    def _late_ns(self) -> int:
        """How long after its tick the next cycle could begin, ns; 0: in time."""
        after = min(self.at + 1, len(self._numbers) - 1)
        counts = (self._log[name] for name in ("overruns", "skipped"))
        overruns, skipped = (int(count[after] - count[self.at]) for count in counts)
        return skipped * self._period_ns + min(overruns, 1)


def numbers(t: F64, period_ns: int) -> NDArray[np.int64]:
    """Numbers of cycles from their scheduled times (K,), s."""
    found: NDArray[np.int64] = np.rint(t * 1e9 / period_ns).astype(np.int64)
    return found
