"""Commands that start at once: forked from a process that has imported and compiled everything.

``python -m tests.integration.fork_server SCENARIO [KEY=VALUE …]`` warms up for a scenario,
says ``ready``, and then forks a child for each line on standard input: a JSON object with
``arguments`` of ``dftc``, ``folder`` to work in, and ``breaks``, names in
:mod:`tests.integration.breakages` that are called in the child first. It prints the child's
pid, and later ``PID CODE``. Signals and faults then meet the command as it always is.
"""

from __future__ import annotations

import json
import os
import select
import signal
import sys
import tempfile
from pathlib import Path

from dftc_rt.cli import main as command
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import warm_up
from tests.integration import breakages


def _child(order: dict[str, object]) -> None:
    folder = Path(str(order["folder"]))
    os.chdir(folder)
    os.environ["TMPDIR"] = str(folder)
    tempfile.tempdir = None
    for name, number in (("stdout", 1), ("stderr", 2)):
        fd = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(fd, number)
        os.close(fd)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for name in order["breaks"]:  # type: ignore[attr-defined]
        getattr(breakages, name)()
    command.main([str(argument) for argument in order["arguments"]])  # type: ignore[attr-defined]


def serve(scenario: str, settings: list[str]) -> None:
    """Warm up and fork until standard input ends."""
    command.build()
    warm_up(open_session(scenario, settings))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    print("ready", flush=True)
    running: set[int] = set()
    buffer = b""
    while True:
        if select.select([0], [], [], 0.02)[0]:
            data = os.read(0, 65536)
            if not data:
                break
            buffer += data
        while b"\n" in buffer:
            line, buffer = buffer.split(b"\n", 1)
            pid = os.fork()
            if pid == 0:
                code = 70
                try:
                    _child(json.loads(line))
                except SystemExit as end:
                    code = int(end.code or 0)
                finally:
                    sys.stdout.flush()
                    sys.stderr.flush()
                    os._exit(code)
            running.add(pid)
            print(f"started {pid}", flush=True)
        for pid in tuple(running):
            found, status = os.waitpid(pid, os.WNOHANG)
            if found:
                running.discard(pid)
                print(f"ended {pid} {os.waitstatus_to_exitcode(status)}", flush=True)
    for pid in running:
        os.kill(pid, signal.SIGKILL)


if __name__ == "__main__":
    serve(sys.argv[1], sys.argv[2:])
