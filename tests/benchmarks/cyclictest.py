"""The floor of wake-up lateness: cyclictest, which does nothing but wait for a deadline."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass

from dftc_rt.errors import EnvironmentLacksError

HISTOGRAM_US = 20_000
_ROW = re.compile(r"^(\d+)\s+(\d+)\s*$", re.MULTILINE)
_MAXIMUM = re.compile(r"^# Max Latencies:\s+(\d+)\s*$", re.MULTILINE)
_OVERFLOWS = re.compile(r"^# Histogram Overflows:\s+(\d+)\s*$", re.MULTILINE)


@dataclass(frozen=True)
class Lateness:
    """Wake-up lateness of one thread.

    Attributes:
        p50_us: Median.
        p99_us: 99th percentile.
        max_us: Largest.
        samples: Wake-ups counted.
        late: Wake-ups that were ``late_us`` or more late.
    """

    p50_us: int
    p99_us: int
    max_us: int
    samples: int
    late: int


def parse(text: str, late_us: int = 1000) -> Lateness:
    """Read cyclictest's histogram of one thread (``-h``, µs).

    Args:
        text: What it printed.
        late_us: From where on a wake-up counts as late.

    Raises:
        ValueError: ``text`` is no such histogram, or counts nothing.
    """
    maximum, overflows = _MAXIMUM.search(text), _OVERFLOWS.search(text)
    counts = [(int(us), int(count)) for us, count in _ROW.findall(text)]
    if maximum is None or overflows is None or not counts:
        raise ValueError(f"no histogram of one thread in {text[-200:]!r}")
    largest = int(maximum[1])
    counts.append((largest, int(overflows[1])))  # beyond the last row: no better than the maximum
    samples = sum(count for _, count in counts)
    if not samples:
        raise ValueError("cyclictest counted no wake-up")
    late = sum(count for us, count in counts if us >= late_us)
    return Lateness(
        _percentile(counts, samples, 50), _percentile(counts, samples, 99), largest, samples, late
    )


def _percentile(counts: list[tuple[int, int]], samples: int, percent: int) -> int:
    """Return the least lateness that ``percent`` of all samples do not exceed."""
    seen = 0
    for us, count in counts:
        seen += count
        if 100 * seen >= percent * samples:
            return us
    return counts[-1][0]


def measure(
    core: int, seconds: int = 10, priority: int = 80, rate_hz: int = 1000, late_us: int = 1000
) -> Lateness:
    """Run cyclictest on one core, SCHED_FIFO, memory locked.

    Args:
        core: Core to pin the thread to.
        seconds: Length of the run.
        priority: SCHED_FIFO priority, 1 to 99.
        rate_hz: Wake-ups per second.
        late_us: From where on a wake-up counts as late.

    Raises:
        EnvironmentLacksError: The program is not installed, or may not run at this priority.
    """
    program = shutil.which("cyclictest")
    if program is None:
        raise EnvironmentLacksError("no program cyclictest", "apt-get install rt-tests")
    command = [
        program, "--quiet", "--mlockall", "--threads=1", f"--affinity={core}",
        f"--priority={priority}", "--policy=fifo", f"--interval={1_000_000 // rate_hz}",
        f"--duration={seconds}", f"--histogram={HISTOGRAM_US}",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise EnvironmentLacksError(
            f"cyclictest failed ({' '.join(done.stderr.split()) or done.returncode})",
            "allow 'rtprio' and 'memlock' in /etc/security/limits.conf, or run as root",
        )
    return parse(done.stdout, late_us)
