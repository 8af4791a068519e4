"""The figure of a fault: tracking error and estimated effectiveness around it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from dftc_rt.analysis import faults as fault_windows
from dftc_rt.analysis.decimate import extremes
from dftc_rt.analysis.metrics import tracking_error
from dftc_rt.errors import EnvironmentLacksError, InputError
from dftc_rt.log.run import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS: Final = 4000
_OWN: Final = "#3b7dd8"
_OTHERS: Final = ("#e0862b", "#3a9d5d", "#d1495b")


def fault_figure(
    run: Run,
    *,
    joint: str | None = None,
    others: Mapping[str, Run] | None = None,
    label: str = "with the gain 1/ρ̂",
    before_s: float = 2.0,
    after_s: float = 6.0,
) -> Figure:
    """Tracking error (mrad) above ρ and ρ̂ with its 2σ band, around a joint's first fault.

    Args:
        run: The run.
        joint: Which joint; None takes that of the first fault.
        others: Runs to compare the error with, by their label: the twin without the fault,
            the same law without the gain.
        label: What to call ``run`` beside them.
        before_s: Shown before the fault, s.
        after_s: Shown after it, s.

    Raises:
        InputError: The run has no fault on that joint.
        EnvironmentLacksError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise EnvironmentLacksError(
            "matplotlib is not installed", "pip install 'dftc_rt[figures]'"
        ) from None

    known = fault_windows.all_faults(run, fault_windows.scenario_of(run))
    fault = next((f for f in known if f.joint in run.joints and joint in (None, f.joint)), None)
    if fault is None:
        raise InputError("figure", f"no fault on {joint or 'any joint'} in this run")
    (fault,) = fault_windows.with_onsets([fault], run)
    i = run.joints.index(fault.joint)
    span = (fault.start_s - before_s, fault.start_s + after_s)
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    for colour, (name, other) in zip(_OTHERS * 4, (others or {}).items(), strict=False):
        _error(top, other, fault.joint, span, name, colour)
    _error(top, run, fault.joint, span, label, _OWN)
    top.set_ylabel("tracking error (mrad)")
    top.set_title(f"{fault.joint}: {fault.kind} at {fault.start_s:g} s", fontsize=10)
    _effectiveness(bottom, run, i, span)
    bottom.set_ylabel("effectiveness")
    bottom.set_xlabel("t (s)")
    bottom.set_xlim(*span)
    for axes in (top, bottom):
        axes.axvline(fault.start_s, color="0.6", linewidth=0.8, linestyle=":")
        axes.grid(alpha=0.25)
        axes.legend(loc="best", fontsize=8, framealpha=0.85)
    return figure


def save(figure: Figure, path: str | Path) -> None:
    """Save as PNG, SVG or PDF, by the name's suffix; the same run gives the same bytes.

    Raises:
        InputError: Another suffix, or the file cannot be written.
    """
    import matplotlib

    suffix = Path(path).suffix.lower()
    dates = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}, ".png": {}}
    if suffix not in dates:
        raise InputError(str(path), f"suffix {suffix!r}", ".png, .svg or .pdf")
    try:
        with matplotlib.rc_context({"svg.hashsalt": "dftc_rt"}):
            figure.savefig(path, dpi=160, metadata=dates[suffix])
    except OSError as error:
        raise InputError(str(path), f"cannot be written: {error.strerror}") from None


def _error(
    axes: Axes, run: Run, joint: str, span: tuple[float, float], label: str, colour: str
) -> None:
    if joint not in run.joints:
        return
    mask = fault_windows.running_mask(run) & fault_windows.within(run.cycle["t"], [span])
    error = tracking_error(run)[mask, run.joints.index(joint)] * 1e3
    kept = extremes(error, _POINTS)
    axes.plot(run.cycle["t"][mask][kept], error[kept], color=colour, linewidth=1.1, label=label)


def _effectiveness(axes: Axes, run: Run, i: int, span: tuple[float, float]) -> None:
    mask = fault_windows.running_mask(run) & fault_windows.within(run.cycle["t"], [span])
    t = run.cycle["t"][mask]
    mean, std = run.cycle["rho_hat"][mask, i], run.cycle["rho_std"][mask, i]
    if np.isfinite(mean + std).any():
        axes.fill_between(t, mean - 2 * std, mean + 2 * std, color=_OWN, alpha=0.2, label="± 2σ")
    axes.plot(t, mean, color=_OWN, linewidth=1.1, label="ρ̂")
    rho = fault_windows.rho_at(run, t)
    if rho is not None:
        axes.plot(t, rho[:, i], color="0.3", linewidth=1.0, linestyle="--", label="ρ (true)")
