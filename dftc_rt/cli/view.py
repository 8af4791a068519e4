"""``dftc view``: a log in the browser, with a slider over its time."""

from __future__ import annotations

from pathlib import Path

from dftc_rt.cli.interruption import stop_requests
from dftc_rt.log.reader import read
from dftc_rt.replay.stored import robot_of
from dftc_rt.rt.process import name_process
from dftc_rt.view.playback import Playback
from dftc_rt.view.server import check_installed


def view(log: str | Path) -> int:
    """Serve a page that plays a log back, until Ctrl-C.

    Prints the address, on 127.0.0.1 and with a token, without which nothing is served.

    Example::

        dftc view run.mcap

    Args:
        log: The log.

    Returns:
        Exit code 0.

    Raises:
        LogError: The log cannot be read, or lacks the robot.
        EnvironmentLacksError: viser is not installed.
    """
    check_installed()
    run = read(log)
    ended: list[bool] = []
    playback = Playback(run, robot_of(run, str(log)), Path(log).name)
    name_process("dftc-view")
    with stop_requests(lambda: ended.append(True)):
        print(f"{playback.page.url}  (Ctrl-C ends)", flush=True)
        if playback.scene.note:
            print(playback.scene.note, flush=True)
        playback.serve(lambda: bool(ended))
    return 0
