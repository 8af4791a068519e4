"""Standard streams that are closed, full or broken, and Ctrl-C before anything has begun."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from dftc_rt.cli.processes.child import Flags
from dftc_rt.cli.processes.launcher import Launcher
from dftc_rt.cli.processes.roles import Rings
from dftc_rt.cli.session import open_session
from tests.integration.commands import DFTC

SHORT = "simulate ur5_elbow_loss --set duration_s=0.1 --set fault=[]"


def said(done: subprocess.CompletedProcess[str]) -> str:
    """Return the one line on stderr; on a fresh machine another says that kernels compile."""
    lines = [line for line in done.stderr.splitlines() if "compiling the kernels" not in line]
    assert len(lines) == 1, done.stderr
    return lines[0]


def shell(line: str) -> subprocess.CompletedProcess[str]:
    """Run a line in which $dftc is the command, by a shell that reports the first of a pipe."""
    script = f'set -o pipefail; dftc="{DFTC}"; {line}'
    return subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("command", ["robots", "--version", SHORT])
def test_a_full_disk_is_one_line(command: str) -> None:
    done = shell(f"$dftc {command} > /dev/full")
    assert done.returncode == 1
    assert said(done) == "dftc: standard output: cannot be written: No space left on device"


@pytest.mark.parametrize("command", ["robots --json", SHORT])
def test_a_closed_output_is_one_line(command: str) -> None:
    done = shell(f"$dftc {command} >&-")
    assert done.returncode == 1
    assert said(done) == "dftc: standard output: cannot be written: Bad file descriptor"


@pytest.mark.parametrize("command", ["robots", "robots --json"])
def test_nobody_reading_is_quiet(command: str) -> None:
    done = shell(f"$dftc {command} | true")
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.parametrize("place", ["2>&-", "2>/dev/full", "2> >(true)"])
def test_diagnostics_that_nobody_gets_change_nothing(place: str) -> None:
    done = shell(f"$dftc bogus {place}")
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "")


def test_a_run_goes_on_without_diagnostics() -> None:
    done = shell(f"$dftc {SHORT} --json 2>&-")
    assert done.returncode == 0
    assert done.stdout.startswith("{")


def test_a_log_never_gets_the_place_of_a_closed_stream(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    shell(f"$dftc {SHORT} --log {log} <&- >&- 2>&-")
    assert log.read_bytes().startswith(b"\x89MCAP0\r\n")
    assert log.read_bytes().endswith(b"\x89MCAP0\r\n")


def test_a_terminal_without_greek_gets_a_summary() -> None:
    done = shell(f"PYTHONIOENCODING=ascii $dftc {SHORT}")
    assert done.returncode == 0
    assert "?s (p50" in done.stdout


_BEFORE = {
    # While modules are loaded, even where an exception would be swallowed.
    "imports": (
        "class Finder:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'dftc_rt.cli.hil':\n"
        "            try:\n"
        "                interrupt()\n"
        "            except BaseException:\n"
        "                pass\n"
        "sys.meta_path.insert(0, Finder())\n"
    ),
    # While the scenario is loaded.
    "loading": (
        "import dftc_rt.cli.session as session\nsession.scenario_robot = lambda *_: interrupt()\n"
    ),
    # While the warm-up sets the drives up.
    "warming up": (
        "import dftc_rt.cli.simulate as simulate\n"
        "connect = simulate.connect\n"
        "simulate.connect = lambda *each: (interrupt(), connect(*each))[1]\n"
    ),
    # While its kernels are compiled, or loaded.
    "compiling": (
        "import dftc_rt.cli.simulate as simulate\n"
        "import numba.core.caching as caching\n"
        "connect, load = simulate.connect, caching.FunctionCache.load_overload\n"
        "def interrupted(*each):\n"
        "    caching.FunctionCache.load_overload = lambda *e: (interrupt(), load(*e))[1]\n"
        "    return connect(*each)\n"
        "simulate.connect = interrupted\n"
    ),
    # When its last cycle is over.
    "warmed up": (
        "from dftc_rt.rt.executor import Executor\n"
        "run = Executor.run\n"
        "Executor.run = lambda executor: (run(executor), interrupt())[0]\n"
    ),
    # When the sockets lie there, and no process has been started.
    "buses": (
        "import dftc_rt.cli.processes.buses as buses\n"
        "listen = buses.listen\n"
        "buses.listen = lambda *each: (listen(*each), interrupt())[0]\n"
    ),
}
_EACH_IN_TURN = itertools.cycle((signal.SIGINT, signal.SIGTERM, signal.SIGHUP))


@pytest.mark.parametrize(
    ("when", "number"), list(zip(_BEFORE.values(), _EACH_IN_TURN, strict=False)), ids=_BEFORE
)
def test_a_signal_before_the_run_is_one_line(when: str, number: int, tmp_path: Path) -> None:
    script = (
        "import os, signal, sys\n"
        "from dftc_rt.cli.main import main\n"
        "def interrupt():\n"
        "    try:\n"
        f"        os.kill(os.getpid(), {number:d})\n"
        "    finally:\n"  # and again, while what is there is cleaned up
        f"        os.kill(os.getpid(), {number:d})\n"
        f"{when}main(['hil', 'ur5_elbow_loss', '--set', 'duration_s=0.1'])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, env=os.environ | {"TMPDIR": str(tmp_path)},
        capture_output=True, text=True, timeout=60, preexec_fn=_hears_ctrl_c,
    )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert said(done) == "dftc: interrupted"
    assert list(tmp_path.iterdir()) == []


def test_a_terminal_that_closes_is_not_heard_under_nohup(tmp_path: Path) -> None:
    script = (
        "import os, signal\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"  # as nohup does
        "import dftc_rt.cli.simulate as simulate\n"
        "from dftc_rt.cli.main import main\n"
        "connect = simulate.connect\n"
        "def hang_up(*each):\n"
        "    os.kill(os.getpid(), signal.SIGHUP)\n"
        "    return connect(*each)\n"
        "simulate.connect = hang_up\n"
        "main(['simulate', 'ur5_elbow_loss', '--set', 'duration_s=0.1'])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr


def _hears_ctrl_c() -> None:
    """Undo what a shell does to what it runs in the background."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def test_a_launcher_that_fails_lets_the_robot_come_to_rest(tmp_path: Path) -> None:
    opened = open_session("ur5_elbow_loss")
    flags, rested = Flags(), tmp_path / "rested"

    def controller() -> dict[str, object]:
        flags.running = True
        while not flags.stop:
            os.sched_yield()
        rested.touch()
        return {}

    def watch(rings: Rings) -> None:
        if flags.running:
            raise OSError("the terminal has gone")

    launcher = Launcher(
        Rings.create(opened), flags, controller, None, lambda path: {}, tmp_path / "x", watch
    )
    with pytest.raises(OSError, match="the terminal has gone"):
        launcher.run()
    assert rested.exists()
