"""Faults drawn at random, at random moments, and what must hold whatever they are."""

from __future__ import annotations

import functools
import os
import random
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.integration.commands import DEADLINE_S, Started
from tests.integration.forked import ForkServer
from tests.integration.survival import LOST_S, Survived, arguments, leaves_nothing, logged

LATEST_S = 1.5  # after the start; of a child, after the controller's
CODES = {0, 1, 3, 130}
LIMIT_NM = 87.0  # of Panda's strongest joints
_PROCESSES = ("dftc-controller", "dftc-rig", "dftc-recorder")
_BREAKAGES = (
    "law_nan", "law_inf", "law_too_much", "law_raises", "law_slow", "hog_in_the_process",
    "bus_lost", "disk_full", "clock_jumps",
)  # fmt: skip
_FAULTS = (
    '{{joint="panda_joint2", kind="emcy", error_code=0x4310, start_s={t:.3f}}}',
    '{{joint="panda_joint4", kind="silent", start_s={t:.3f}}}',
    '{{joint="panda_joint4", kind="restart", start_s={t:.3f}}}',
    '{{joint="panda_joint2", kind="total", start_s={t:.3f}}}',
    '{{joint="panda_joint6", kind="stuck_torque", start_s={t:.3f}}}',
    '{{joint="panda_joint2", kind="sensor_frozen", start_s={t:.3f}}}',
    '{{kind="frame_loss", bus="can0", probability=0.1, start_s={t:.3f}}}',
    '{{kind="frame_corruption", bus="can1", probability=0.1, retransmit=false, start_s={t:.3f}}}',
    '{{kind="frame_duplication", bus="can2", probability=0.5, start_s={t:.3f}}}',
    '{{kind="bus_off", bus="can1", start_s={t:.3f}}}',
)


@dataclass(frozen=True)
class Draw:
    """What happens to one run.

    Attributes:
        signals: (process, signal, when): process "" is the launcher; seconds after its start,
            for a child after the controller's.
        breaks: Of :mod:`tests.integration.breakages`.
        faults: Of the scenario, in TOML.
    """

    signals: tuple[tuple[str, int, float], ...]
    breaks: tuple[str, ...]
    faults: tuple[str, ...]

    def __str__(self) -> str:
        told = [
            f"{name or 'dftc'} {signal.Signals(n).name} {t:.3f} s" for name, n, t in self.signals
        ]
        return "; ".join([*told, *self.breaks, *self.faults]) or "nothing"


def draw(random_: random.Random) -> Draw:
    """Draw one to three things that happen."""
    signals: list[tuple[str, int, float]] = []
    breaks: list[str] = []
    faults: list[str] = []
    for _ in range(random_.randint(1, 3)):
        when = random_.uniform(0.0, LATEST_S)
        match random_.randrange(5):
            case 0 | 1:
                number = random_.choice((signal.SIGKILL, signal.SIGSTOP))
                name = random_.choice(_PROCESSES)
                signals.append((name, number, when))
                if number == signal.SIGSTOP and random_.random() < 0.5:  # a pause
                    signals.append((name, signal.SIGCONT, when + random_.uniform(0.0, 0.6)))
            case 2:
                number = random_.choice((signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
                signals += [("", number, when)] * random_.randint(1, 2)
            case 3:
                breaks.append(random_.choice(_BREAKAGES))
            case 4:
                faults.append(random_.choice(_FAULTS).format(t=random_.uniform(0.0, 1.0)))
    return Draw(
        tuple(sorted(signals, key=lambda one: one[2])), tuple(dict.fromkeys(breaks)), tuple(faults)
    )


def endure(server: ForkServer, folder: Path, drawn: Draw) -> Survived | None:
    """Let a run suffer what was drawn; check what must hold; None where nothing was logged.

    Raises:
        AssertionError: Something does not hold.
        TimeoutError: It hangs.
    """
    folder.mkdir(parents=True)
    words = [*arguments(folder, 1.5), "--set", f"fault=[{', '.join(drawn.faults)}]"]
    started = time.monotonic()
    with server.start(folder / "work", words, ("short_patience", *drawn.breaks)) as run:
        pids: set[int] = set()
        for child in (False, True):
            if child and any(name for name, _, _ in drawn.signals):
                _wait(run, pids, lambda: "dftc-controller" in run.children())
                started = time.monotonic()
            for name, number, when in drawn.signals:
                if bool(name) is child:
                    _wait(run, pids, functools.partial(_passed, started + when))
                    target = run.children().get(name) if child else run.process.pid
                    if target is not None and run.process.poll() is None:
                        os.kill(target, number)
        _wait(run, pids, lambda: False)
        code = run.end()
        leaves_nothing(run, pids)
        log = logged(folder)
        # A signal may end the interpreter before the command's first line.
        unborn = code < 0 and log is None and not run.err
        assert code in CODES or unborn, f"exit code {code}: {run.err}"
        if log is None:
            return None
        ended = Survived(code, run.err, log)
    check(ended, drawn)
    return ended


def _passed(moment: float) -> bool:
    return time.monotonic() >= moment


def _wait(run: Started, pids: set[int], over: Callable[[], bool]) -> None:
    """Wait for its end or a moment, and note the children that there are meanwhile.

    Raises:
        TimeoutError: Neither came.
    """
    deadline = time.monotonic() + DEADLINE_S
    while run.process.poll() is None and not over():
        if time.monotonic() > deadline:
            raise TimeoutError(f"it has not ended: {run.err}")
        pids |= set(run.children().values())
        time.sleep(0.01)


def check(ended: Survived, drawn: Draw) -> None:
    """Check the log, and by the rig's own account the arm."""
    assert "Traceback" not in ended.err
    alive = not any(name == "dftc-rig" and n != signal.SIGCONT for name, n, _ in drawn.signals)
    whole = alive and "disk_full" not in drawn.breaks
    rig = ended.log.rig
    if rig is None or not rig["t"].size:
        assert not whole or not ended.log.cycle["t"].size, "cycles were logged, and no truth"
        return
    assert np.abs(rig["tau_applied"]).max() <= LIMIT_NM
    if "disk_full" not in drawn.breaks:
        assert np.diff(rig["t"]).max(initial=0.0) <= LOST_S
    if whole:
        # However it ended: no torque and no motion at the end.
        assert not rig["tau_applied"][-1].any()
        assert not rig["v"][-1].any()
