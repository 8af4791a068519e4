"""Figures of the page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from dftc_rt.benchmark import statistics
from dftc_rt.benchmark.cases import KINDS
from dftc_rt.benchmark.select import Rows
from dftc_rt.benchmark.table import law_title
from dftc_rt.errors import EnvironmentLacksError, InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DELAYS: Final = "images/benchmark_delays.png"
ESTIMATES: Final = "images/benchmark_estimates.png"
TRACKING: Final = "images/benchmark_tracking.png"
_DPI: Final = 110
_LOSSES: Final = ("loss20", "loss40", "loss70")
_NEVER_S: Final = 10.0  # where a delay that never ended is drawn: to the right of all others


def require() -> None:
    """Refuse to begin without matplotlib.

    Raises:
        EnvironmentLacksError: It is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise EnvironmentLacksError(
            "matplotlib is not installed", "pip install 'dftc_rt[figures]'"
        ) from None


def draw_all(rows: Rows, folder: Path) -> list[str]:
    """Draw the figures for which there are rows; return their names, relative to the folder.

    Raises:
        InputError: A file cannot be written.
    """
    from matplotlib import style

    files = []
    with style.context("default"):  # whatever the user's matplotlibrc says
        for name, draw in ((DELAYS, _delays), (ESTIMATES, _estimates), (TRACKING, _tracking)):
            figure = draw(rows)
            if figure is not None:
                _save(figure, folder / name)
                files.append(name)
    return files


def _delays(rows: Rows) -> Figure | None:
    """Shares of cases noticed, and attributed, over the time since the fault."""
    if not rows.cases():
        return None
    figure, axes = _row(2)
    for axis, title in zip(axes, ("anomaly", "actuator loss"), strict=True):
        for kind in _LOSSES:
            found = rows.cases(kind=kind)
            if found:
                values = [
                    row.anomaly_delay_s if title == "anomaly" else row.attribution_delay_s
                    for row in found
                ]
                _steps(axis, values, f"dftc, {kind}")
        other = rows.cases("momentum", kind="loss40")
        if other:
            values = [
                row.anomaly_delay_s if title == "anomaly" else row.attribution_delay_s
                for row in other
            ]
            _steps(axis, values, "B1, loss40", "--")
        axis.set_xscale("log")
        axis.set_xlim(0.005, 6.0)
        axis.set_ylim(0.0, 1.02)
        axis.set_title(f"verdict {title}", fontsize=9)
        axis.set_xlabel("time since the fault (s)", fontsize=8)
        axis.legend(fontsize=7, loc="lower right")
    axes[0].set_ylabel("share of cases", fontsize=8)
    return figure


def _estimates(rows: Rows) -> Figure | None:
    """RMSE of ρ̂ over the load of the joint."""
    figure, (axis,) = _row(1)
    drawn = False
    for kind in _LOSSES:
        found = [row for row in rows.cases(kind=kind) if row.rho_rmse is not None]
        if found:
            drawn = True
            axis.plot(
                [100 * row.torque_share for row in found], [row.rho_rmse or 0.0 for row in found],
                "o", ms=3, alpha=0.6, label=kind,
            )  # fmt: skip
    if not drawn:
        return None
    axis.axhline(0.03, color="0.4", lw=0.8, ls=":")
    axis.set_yscale("log")
    axis.set_xlabel("RMS torque of the twin (% of the limit)", fontsize=8)
    axis.set_ylabel("RMSE of ρ̂ in the faulty window", fontsize=8)
    axis.legend(fontsize=7)
    return figure


def _tracking(rows: Rows) -> Figure | None:
    """Tracking error of the faulted joint over the twin's, by law and kind."""
    laws = [law for law in rows.laws() if rows.cases(*law)]
    if not laws:
        return None
    kinds = [kind for kind in KINDS if kind != "total"]
    figure, (axis,) = _row(1)
    width = 0.8 / len(laws)
    for k, law in enumerate(laws):
        medians = [
            statistics.median(
                [row.rmse_mrad / row.rmse_twin_mrad for row in rows.cases(*law, kind)
                 if row.rmse_mrad is not None and row.rmse_twin_mrad]
            )
            for kind in kinds
        ]  # fmt: skip
        at = np.arange(len(kinds)) + (k - 0.5 * (len(laws) - 1)) * width
        axis.bar(at, medians, width, label=law_title(*law).replace("`", ""))
    axis.axhline(1.0, color="0.4", lw=0.8, ls=":")
    axis.set_yscale("log")
    axis.set_xticks(range(len(kinds)), kinds, fontsize=7)
    axis.set_ylabel("RMSE of the faulted joint over the twin's, median", fontsize=8)
    axis.legend(fontsize=6, ncols=3)
    return figure


def _steps(axis: Axes, values: list[float | None], label: str, line: str = "-") -> None:
    ends = sorted(_NEVER_S if value is None else max(value, 1e-3) for value in values)
    shares = np.arange(1, len(ends) + 1) / len(ends)
    axis.step([1e-3, *ends], [0.0, *shares], line, where="post", lw=1.2, label=label)


def _row(columns: int) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
    axes = list(figure.subplots(1, columns, squeeze=False)[0])
    for axis in axes:
        axis.tick_params(labelsize=7)
        axis.grid(alpha=0.25)
    return figure, axes


def _save(figure: Figure, path: Path) -> None:
    try:
        path.parent.mkdir(exist_ok=True)
        figure.savefig(path, dpi=_DPI, metadata={"Software": None})
    except OSError as error:
        raise InputError(str(path), f"cannot be written: {error.strerror}") from None
