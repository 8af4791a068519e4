"""What a machine lacks for hard timing and for CAN, and how to get it.

Each check is a function of a :class:`~dftc_rt.rt.machine.Machine` and changes
nothing. What is not essential costs precision or a feature, never correctness: every
run works without it, and says so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from dftc_rt.rt.machine import Machine


@dataclass(frozen=True)
class Check:
    """One finding.

    Attributes:
        name: What was looked at.
        ok: Whether it is as it should be.
        found: What was found.
        means: What a run loses where it is not.
        remedy: How to get it.
        essential: Whether the program cannot do its work without it.
    """

    name: str
    ok: bool
    found: str
    means: str
    remedy: str
    essential: bool = False


REQUIRED: Final = (
    "can", "canopen", "cyclopts", "foxglove", "lz4", "mcap", "msgspec", "numba", "numpy",
    "pinocchio", "plotly", "rich", "scipy", "tomli_w",
)  # fmt: skip

OPTIONAL: Final = {
    "cantools": ("dbc", "no DBC files of the traffic (dftc bus dbc)"),
    "matplotlib": ("figures", "no figures as images; reports have theirs all the same"),
    "mujoco": ("bench", "make benchmark has no floor for the plant's speed"),
}
"""Module -> extra, and what is lost; an extra that nothing uses yet is not asked for."""


def python(machine: Machine) -> Check:
    """The interpreter is 3.11 or newer."""
    major, minor = machine.python
    return Check(
        "python",
        machine.python >= (3, 11),
        f"{major}.{minor}",
        "nothing runs",
        "install Python 3.11 or newer, then remove .venv and make it again",
        essential=True,
    )


def system(machine: Machine) -> Check:
    """The system is Linux: rings, priorities and CAN sockets are its own."""
    return Check(
        "operating system",
        machine.system == "Linux",
        machine.system,
        "nothing that uses rings, priorities or CAN sockets runs",
        "run on Linux, or in a Linux container",
        essential=True,
    )


def packages(machine: Machine) -> Check:
    """The Python packages that every command needs are installed."""
    missing = [name for name in REQUIRED if not machine.has_module(name)]
    return Check(
        "python packages",
        not missing,
        f"missing: {', '.join(missing)}" if missing else "all installed",
        "commands fail on import",
        "pip install --force-reinstall dftc_rt",
        essential=True,
    )


def extras(machine: Machine) -> list[Check]:
    """The packages behind the optional extras, one check each."""
    found = []
    for module, (extra, means) in OPTIONAL.items():
        ok = machine.has_module(module)
        state = "installed" if ok else "not installed"
        remedy = f"pip install 'dftc_rt[{extra}]'"
        found.append(Check(f"extra {extra}", ok, state, means, remedy))
    return found


def cores(machine: Machine) -> Check:
    """There is a core for the loop and one for everything else."""
    return Check(
        "processor cores",
        machine.cores >= 2,
        str(machine.cores),
        "recorder and report compete with the loop; expect skipped cycles",
        "give the container or virtual machine a second core, or use --lockstep",
    )


def fifo(machine: Machine) -> Check:
    """SCHED_FIFO may be taken."""
    refusal = machine.refuses_fifo()
    return Check(
        "SCHED_FIFO",
        not refusal,
        refusal or "permitted",
        "other programs preempt the loop: wake-ups late by milliseconds",
        "add '@GROUP - rtprio 99' to /etc/security/limits.conf and log in again, "
        "or run as root; in a container add the capability SYS_NICE",
    )


def memory(machine: Machine) -> Check:
    """Memory may be locked."""
    refusal = machine.refuses_mlockall()
    return Check(
        "locked memory",
        not refusal,
        refusal or "permitted",
        "a page fault in the loop costs up to milliseconds",
        "add '@GROUP - memlock unlimited' to /etc/security/limits.conf and log in again; "
        "in a container add the capability IPC_LOCK",
    )


def sleep_states(machine: Machine) -> Check:
    """Processor sleep states can be held off."""
    path = "/dev/cpu_dma_latency"
    ok = bool(machine.paths(path)) and machine.writable(path)
    return Check(
        "processor sleep states",
        ok,
        f"{path} {'is writable' if ok else 'is missing or not writable'}",
        "waking from a deep sleep state adds up to 200 µs to a cycle",
        f"chmod o+w {path} as root (a udev rule makes it last), "
        "or boot with processor.max_cstate=1",
    )


def throttling(machine: Machine) -> Check:
    """The kernel leaves real-time processes nearly all of a period."""
    runtime = machine.read("/proc/sys/kernel/sched_rt_runtime_us") or "unknown"
    period = machine.read("/proc/sys/kernel/sched_rt_period_us") or "1000000"
    return Check(
        "real-time throttling",
        runtime in ("unknown", "-1") or float(runtime) >= 0.9 * float(period),
        f"{runtime} of {period} µs",
        "a real-time process is stopped for the rest of each period",
        "sysctl kernel.sched_rt_runtime_us=950000 as root",
    )


def preemption(machine: Machine) -> Check:
    """The kernel is fully preemptible."""
    ok = machine.read("/sys/kernel/realtime") == "1"
    version = (machine.read("/proc/version") or "unknown").split(" (")[0]
    return Check(
        "PREEMPT_RT kernel",
        ok,
        f"{version}{', PREEMPT_RT' if ok else ', not PREEMPT_RT'}",
        "p99 of the wake-ups is usually fine, the worst one is not bounded",
        "install your distribution's real-time kernel "
        "(Debian: apt-get install linux-image-rt-amd64) and boot it",
    )


def governor(machine: Machine) -> Check:
    """The cores do not lower their clock."""
    files = machine.paths("/sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")
    found = sorted({machine.read(path) or "unreadable" for path in files})
    return Check(
        "frequency governor",
        not found or found == ["performance"],
        ", ".join(found) or "no frequency scaling to be seen",
        "the clock drops between cycles, compute times vary",
        "cpupower frequency-set -g performance, as root",
    )


def seqpacket(machine: Machine) -> Check:
    """The user-space bus has its kind of socket."""
    refusal = machine.refuses_seqpacket()
    return Check(
        "AF_UNIX SOCK_SEQPACKET",
        not refusal,
        refusal or "available",
        "no user-space CAN bus",
        "run on Linux, and let the sandbox allow AF_UNIX sockets",
        essential=True,
    )


def bus_directory(machine: Machine) -> Check:
    """The directory of the user-space buses is ours alone."""
    path, problem = machine.bus_directory()
    return Check(
        "bus directory",
        not problem,
        f"{path}{': ' + problem if problem else ''}",
        "dftc rig and dftc control find no user-space bus there (dftc hil makes its own)",
        "name a directory that is yours, of mode 0700, with --bus-dir or $DFTC_BUS_DIR",
    )


def can(machine: Machine) -> Check:
    """The kernel has CAN sockets."""
    refusal = machine.refuses_can()
    return Check(
        "kernel CAN (AF_CAN)",
        not refusal,
        refusal or "available",
        "no SocketCAN interface, real or virtual; the user-space bus works all the same",
        "modprobe -a can can_raw as root, or boot a kernel built with CONFIG_CAN",
    )


def vcan(machine: Machine) -> Check:
    """There are virtual CAN links."""
    links = machine.vcan_links()
    return Check(
        "vcan links",
        bool(links),
        ", ".join(links) or "none",
        "--bus auto takes the user-space bus",
        "dftc bus up SCENARIO, as root; modprobe vcan before, where the kernel has it as a module",
    )


def cyclictest(machine: Machine) -> Check:
    """The program behind the timing benchmark's floor is installed."""
    path = machine.program("cyclictest")
    return Check(
        "cyclictest",
        bool(path),
        path or "not installed",
        "make benchmark has no floor for wake-up lateness",
        "apt-get install rt-tests",
    )


def kernel_cache(machine: Machine) -> Check:
    """Compiled kernels can be kept."""
    usable = [path for path in machine.kernel_caches if machine.writable(path)]
    return Check(
        "numba cache",
        bool(usable),
        usable[0] if usable else f"not writable: {', '.join(machine.kernel_caches)}",
        "every start compiles for many seconds",
        "set NUMBA_CACHE_DIR to a directory you may write to",
    )


CHECKS: Final[tuple[Callable[[Machine], Check], ...]] = (
    python, system, packages, cores, fifo, memory, sleep_states, throttling, preemption,
    governor, seqpacket, bus_directory, can, vcan, cyclictest, kernel_cache,
)  # fmt: skip


def examine(machine: Machine | None = None) -> list[Check]:
    """Return every finding about ``machine`` (default: this one)."""
    machine = machine or Machine()
    return [check(machine) for check in CHECKS] + extras(machine)
