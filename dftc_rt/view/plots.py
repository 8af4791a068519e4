"""Curves beside the robot: effectiveness of every joint; error and torque of a chosen one."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_COLOURS: Final = (
    "#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f",
    "#bcbd22", "#17becf",
)  # fmt: skip
_HEIGHT: Final = 130


class Plots:
    """Three plots over time. Their data is given anew as a whole."""

    def __init__(self, gui: Any, joints: tuple[str, ...]) -> None:
        """Add the plots and the choice of a joint.

        Args:
            gui: ``gui`` of a ``viser.ViserServer``.
            joints: Joint names.
        """
        self._n = len(joints)
        empty = np.zeros(1)
        self._effectiveness = _plot(gui, "ρ̂ of every joint", [(j, empty) for j in joints], empty)
        self.joint = gui.add_dropdown("curves of", joints, initial_value=joints[0])
        self._joints = joints
        self._error = _plot(gui, "tracking error / mrad", [("error", empty)], empty)
        self._torque = _plot(gui, "torque sent / Nm", [("torque", empty)], empty)
        self._share = _plot(gui, "ρ̂ and true ρ", [("ρ̂", empty), ("ρ", empty)], empty)

    @property
    def chosen(self) -> int:
        """Index of the chosen joint."""
        return self._joints.index(self.joint.value)

    def show(self, t: F64, rho_hat: F64, rho: F64 | None, error_mrad: F64, torque: F64) -> None:
        """Draw.

        Args:
            t: Times, (K,), s.
            rho_hat: Estimated effectiveness, (K, n).
            rho: True effectiveness, (K, n); None without a rig.
            error_mrad: Tracking error, (K, n), mrad (mm).
            torque: As sent, (K, n), Nm (N).
        """
        i = self.chosen
        truth = np.full(len(t), np.nan) if rho is None else rho[:, i]
        self._effectiveness.data = (t, *(rho_hat[:, k] for k in range(self._n)))
        self._error.data = (t, error_mrad[:, i])
        self._torque.data = (t, torque[:, i])
        self._share.data = (t, rho_hat[:, i], truth)


class Window:
    """The last seconds of a few signals, at a few samples a second."""

    def __init__(self, n: int, samples: int) -> None:
        """Keep ``samples`` samples of n joints."""
        self._samples = samples
        self._rows: list[F64] = []
        self._n = n

    def add(self, t: float, rho_hat: F64, rho: F64 | None, error_mrad: F64, torque: F64) -> None:
        """Add a sample; one that is no later than the last is passed over."""
        if self._rows and t <= self._rows[-1][0]:
            return
        truth = np.full(self._n, np.nan) if rho is None else rho
        self._rows.append(np.concatenate([[t], rho_hat, truth, error_mrad, torque]))
        del self._rows[: -self._samples]

    def __len__(self) -> int:
        return len(self._rows)

    def draw(self, plots: Plots) -> None:
        """Show what is kept."""
        block = np.array(self._rows)
        t, rho_hat, rho, error, torque = np.split(block, 1 + self._n * np.arange(4), axis=1)
        plots.show(t[:, 0], rho_hat, rho, error, torque)


def _plot(gui: Any, title: str, lines: list[tuple[str, F64]], t: F64) -> Any:
    series: list[dict[str, str | float]] = [{"label": "t / s"}]
    for k, (label, _) in enumerate(lines):
        series.append({"label": label, "stroke": _COLOURS[k % len(_COLOURS)], "width": 1.5})
    return gui.add_uplot(
        (t, *(values for _, values in lines)),
        tuple(series),
        title=title,
        scales={"x": {"time": False}},
        legend={"show": False},
        height=_HEIGHT,
    )
