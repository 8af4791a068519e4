"""What the page costs the loop: ``dftc hil`` with and without it, turn by turn.

A client is connected all the while and takes everything that the page sends, so that it has all of
its work to do. No browser: one that draws on the processor would be measured in its place.
"""

from __future__ import annotations

import contextlib
import re
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.benchmarks.processes import read_json
from tests.benchmarks.result import Aim, Result, Table

SCENARIO = "panda_shoulder_loss"
_ALLOWED = 1.1  # of the median p99 of the runs without: what two halves of the same runs differ by


def run(quick: bool = False) -> Result:
    """Measure.

    Args:
        quick: Two short runs, to see that it works: the page takes some seconds to come up.
    """
    seconds, rounds = (12, 1) if quick else (30, 5)
    found: dict[bool, list[dict[str, Any]]] = {False: [], True: []}
    taken: list[int] = []
    with tempfile.TemporaryDirectory(prefix="dftc-benchmark-") as folder:
        for number in range(rounds):
            for view in (False, True) if number % 2 == 0 else (True, False):
                summary, messages = _hil(view, seconds, Path(folder) / f"{number}{view}.mcap")
                found[view].append(summary)
                if view:
                    taken.append(messages)
    rows: list[tuple[str | float | None, ...]] = []
    ratios: dict[str, float] = {}
    for key in ("lateness_us", "exchange_us", "compute_us"):
        medians = [
            float(np.median([summary[key]["p99"] for summary in found[view]]))
            for view in (False, True)
        ]
        ratios[key] = medians[1] / medians[0]
        rows.append((key.removesuffix("_us"), *medians, ratios[key]))
    watched = min(taken) > 0  # a run whose page came too late to be watched proves nothing
    overruns = [float(np.median([s["overruns"] for s in found[view]])) for view in (False, True)]
    rows.append(("overruns", *overruns, None))
    return Result(
        "view",
        [
            Table(
                f"The page: panda, 1 kHz, {rounds} x {seconds} s each in turn; median of p99, us",
                ("", "without", "with", "ratio"),
                rows,
            )
        ],
        [
            Aim(
                f"p99 of {key.removesuffix('_us')}, with the page over without",
                "<=",
                _ALLOWED,
                ratio if watched else None,
            )
            for key, ratio in ratios.items()
        ],
        [f"messages that came from the page in each run with it: {', '.join(map(str, taken))}"],
    )


def _hil(view: bool, seconds: float, log: Path) -> tuple[dict[str, Any], int]:
    """Run once; return the summary, and how many messages the page sent."""
    command: list[str | Path] = [
        sys.executable, "-c", "from dftc_rt.cli.main import main; main()", "hil", SCENARIO,
        "--bus", "unix", "--json", "--no-report", "--log", log, "--set", f"duration_s={seconds}",
    ]  # fmt: skip
    if not view:
        return read_json(command, seconds), 0
    said = log.with_suffix(".err")
    taken: list[int] = []
    ended = threading.Event()
    client = threading.Thread(target=_watch, args=(said, taken, ended))
    client.start()
    try:
        return read_json([*command, "--view"], seconds, said), len(taken)
    finally:
        ended.set()
        client.join()


def _watch(said: Path, taken: list[int], ended: threading.Event) -> None:
    """Be a page: say where the camera is, and take what comes."""
    while not ended.wait(0.1):
        found = re.search(r"view: http://(\S+)/\?token=(\S+)", _text(said))
        if found:
            break
    else:
        return
    protocol: Any = f"viser-v{viser.__version__}"
    with (
        contextlib.suppress(ConnectionClosed, OSError),
        connect(f"ws://{found[1]}/{found[2]}", subprotocols=[protocol], max_size=None) as pipe,
    ):
        pipe.send(_camera())
        while not ended.is_set():
            pipe.recv()
            taken.append(1)


def _camera() -> bytes:
    """What a browser says of its camera; without it nobody counts as looking."""
    return msgspec.msgpack.encode(
        {
            "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "fov": 1.0,
            "position": (2.0, -2.0, 1.0), "near": 0.1, "far": 100.0, "image_height": 800,
            "image_width": 1000, "look_at": (0.0, 0.0, 0.5), "up_direction": (0.0, 0.0, 1.0),
        }
    )  # fmt: skip


def _text(path: Path) -> str:
    return path.read_text() if path.exists() else ""
