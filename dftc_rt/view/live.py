"""The page of a run that is going on: reads shared memory, and can break things and stop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from dftc_rt.view.panel import FaultPanel
from dftc_rt.view.plots import Plots, Window
from dftc_rt.view.run import LiveRun
from dftc_rt.view.scene import RobotScene
from dftc_rt.view.server import PageServer
from dftc_rt.view.snapshot import Snapshot

FRAMES_PER_S: Final = 25
_SAMPLE_FRAMES: Final = 2  # a sample of the curves every so many frames
_DRAW_FRAMES: Final = 10  # curves and table are drawn anew
_SAMPLES: Final = 250  # of a curve: 20 s


class LivePage:
    """Serves a run.

    Attributes:
        url: Address with the token.
        note: What the scene has to say; "" when nothing.
    """

    def __init__(
        self, name: str, run: LiveRun, stop: Callable[[], None], faults: Path | None
    ) -> None:
        """Serve; nothing moves before :meth:`serve`.

        Args:
            name: Of the scenario.
            run: The run.
            stop: Asks for a safe stop.
            faults: Where the rig takes faults; None: it takes none.

        Raises:
            EnvironmentLacksError: viser is not installed.
        """
        self._run = run
        self._page = PageServer(f"dftc · {name}")
        self.url = self._page.url
        self._scene = RobotScene(self._page.viser, run.robot)
        self.note = self._scene.note
        gui = self._page.viser.gui
        joints = run.robot.joints
        self._status = gui.add_markdown("not running yet")
        stopped = gui.add_button("safe stop", color="red")
        stopped.on_click(lambda _: stop())
        self._pause = gui.add_checkbox("pause the page", initial_value=False)
        ghost = gui.add_checkbox("desired pose", initial_value=True)
        ghost.on_update(lambda _: self._scene.show_ghost(ghost.value))
        if faults is not None:
            FaultPanel(gui, joints, faults)
        self._table = gui.add_markdown("")
        with gui.add_folder("curves"):
            self._plots = Plots(gui, joints)
        self._window = Window(run.robot.n, _SAMPLES)

    def serve(self, ended: Callable[[], bool]) -> None:
        """Show what is new until ``ended``, at most :data:`FRAMES_PER_S` times a second."""
        frame = 0
        while not ended():
            begun = time.monotonic()
            now = self._run.now()
            if now is not None and not self._pause.value:
                if frame % _SAMPLE_FRAMES == 0:
                    self._window.add(now.t, now.rho_hat, now.rho, now.error_mrad, now.torque)
                if self._page.watched:
                    self._show(now, frame)
            frame += 1
            time.sleep(max(1.0 / FRAMES_PER_S - (time.monotonic() - begun), 1e-3))
        self._page.close()

    def _show(self, now: Snapshot, frame: int) -> None:
        self._scene.show(now.q, now.desired, now.rho_hat)
        if frame % _DRAW_FRAMES == 0:
            self._status.content = f"{now.headline()}\n\n{self._load()}"
            self._table.content = now.table(self._run.robot.joints)
            if len(self._window) > 1:
                self._window.draw(self._plots)

    def _load(self) -> str:
        """How busy the buses are."""
        loads = zip(self._run.buses, self._run.loads().tolist(), strict=True)
        told = [f"{name} {load:.0%}" for name, load in loads if not math.isnan(load)]
        return "bus load: " + (", ".join(told) or "not counted")
