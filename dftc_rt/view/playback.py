"""The page of a log: a slider over its time, and the same scene and curves as of a run."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.analysis.decimate import extremes
from dftc_rt.dynamics.model import Robot
from dftc_rt.errors import LogError
from dftc_rt.log.run import Run
from dftc_rt.view.plots import Plots
from dftc_rt.view.scene import RobotScene
from dftc_rt.view.server import PageServer
from dftc_rt.view.snapshot import Snapshot, state_words

F64 = NDArray[np.float64]

FRAMES_PER_S: Final = 30
_POINTS: Final = 600  # of a curve
_SPEEDS: Final = ("0.1", "0.25", "0.5", "1", "2", "4")


class Playback:
    """Serves a log.

    Attributes:
        page: The server.
        scene: The robot.
    """

    def __init__(self, run: Run, robot: Robot, where: str = "the log") -> None:
        """Serve; the page shows the first cycle.

        Args:
            run: The log.
            robot: Its robot.
            where: Its name.

        Raises:
            LogError: It has no cycle.
            EnvironmentLacksError: viser is not installed.
        """
        self._t = run.cycle["t"]
        if not len(self._t):
            raise LogError(where, "no cycle was logged", "a run")
        self._run = run
        self._truth = None if run.rig is None or not len(run.rig["t"]) else run.rig
        self.page = PageServer(f"dftc · {where}")
        self.scene = RobotScene(self.page.viser, robot)
        gui = self.page.viser.gui
        first, last = float(self._t[0]), float(self._t[-1])
        self._status = gui.add_markdown("")
        with gui.add_folder("playback"):
            self._slider = gui.add_slider(
                "time / s", first, max(last, first + 1e-3), 1e-3, initial_value=first
            )
            self._playing = gui.add_checkbox("play", initial_value=False)
            self._speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1")
            ghost = gui.add_checkbox("desired pose", initial_value=True)
            ghost.on_update(lambda _: self.scene.show_ghost(ghost.value))
        self._table = gui.add_markdown("")
        with gui.add_folder("curves"):
            self._plots = Plots(gui, run.joints)
        self._plots.joint.on_update(lambda _: self._draw())
        self._draw()
        self._shown = -1.0
        self.show(first)

    def at(self, t: float) -> Snapshot:
        """The newest moment at or before ``t``, s; the first one before it."""
        k = max(int(np.searchsorted(self._t, t + 1e-9, side="right")) - 1, 0)
        cycle, truth = self._run.cycle, self._truth
        rho = None
        if truth is not None:
            r = int(np.searchsorted(truth["t"], self._t[k] + 1e-9, side="right")) - 1
            rho = truth["rho"][max(r, 0)]
        return Snapshot(
            t=float(self._t[k]),
            state=state_words(cycle["state"][k]),
            lateness_s=float(cycle["lateness"][k]),
            overruns=int(cycle["overruns"][k]),
            q=cycle["q"][k],
            desired=cycle["qd"][k],
            rho_hat=cycle["rho_hat"][k],
            torque=cycle["tau_cmd"][k],
            verdict=cycle["verdict"][k],
            rho=rho,
        )

    def show(self, t: float) -> None:
        """Show the moment at ``t``, s, if it is another than before."""
        if t == self._shown:
            return
        self._shown = t
        now = self.at(t)
        self.scene.show(now.q, now.desired, now.rho_hat)
        self._status.content = now.headline()
        self._table.content = now.table(self._run.joints)

    def serve(self, ended: Callable[[], bool]) -> None:
        """Play until ``ended``."""
        last = time.monotonic()
        while not ended():
            time.sleep(1.0 / FRAMES_PER_S)
            now = time.monotonic()
            if self._playing.value:
                t = self._slider.value + (now - last) * float(self._speed.value)
                self._slider.value = float(np.clip(t, self._t[0], self._t[-1]))
            last = now
            self.show(self._slider.value)
        self.page.close()

    def _draw(self) -> None:
        """Draw the curves of the whole run, with every peak of the chosen joint's error."""
        cycle: Any = self._run.cycle
        error = 1e3 * (cycle["q"] - cycle["qd"])
        i = self._plots.chosen
        kept = np.union1d(
            extremes(error[:, i], _POINTS // 2), extremes(cycle["rho_hat"][:, i], _POINTS // 2)
        )
        rho = None
        if self._truth is not None:
            at = np.searchsorted(self._truth["t"], self._t[kept] + 1e-9, side="right") - 1
            rho = self._truth["rho"][np.maximum(at, 0)]
        self._plots.show(
            self._t[kept], cycle["rho_hat"][kept], rho, error[kept], cycle["tau_cmd"][kept]
        )
