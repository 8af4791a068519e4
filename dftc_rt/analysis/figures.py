"""Figures for papers, through matplotlib: of a joint over a run, or around its fault."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from dftc_rt.analysis import faults as fault_windows
from dftc_rt.analysis.decimate import extremes
from dftc_rt.analysis.metrics import tracking_error
from dftc_rt.analysis.threshold import residual_threshold
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
    figure_of = _figure_class()
    known = fault_windows.all_faults(run, fault_windows.scenario_of(run))
    fault = next((f for f in known if f.joint in run.joints and joint in (None, f.joint)), None)
    if fault is None:
        raise InputError("figure", f"no fault on {joint or 'any joint'} in this run")
    (fault,) = fault_windows.with_onsets([fault], run)
    i = run.joints.index(fault.joint)
    span = (fault.start_s - before_s, fault.start_s + after_s)
    figure = figure_of(figsize=(7.0, 4.6), layout="constrained")
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


def joint_to_show(runs: Mapping[str, Run]) -> str:
    """Return the joint of the first fault of any run; without one, that of the largest error."""
    for run in runs.values():
        for fault in fault_windows.faults_of(fault_windows.scenario_of(run)):
            if fault.joint in run.joints:
                return fault.joint
    run = next(iter(runs.values()))
    error = np.where(fault_windows.running_mask(run)[:, None], tracking_error(run), 0.0)
    return run.joints[int(np.argmax(np.sum(error**2, axis=0)))]


def joint_figure(
    runs: Mapping[str, Run],
    joint: str,
    span: tuple[float, float] | None = None,
    title: str = "",
) -> Figure:
    """Tracking error, effectiveness, torque and residual of a joint, of one run or of several.

    Args:
        runs: By label; that of a single one is not shown.
        joint: Which joint.
        span: From when to when, s; None: while the controllers ran.
        title: Above the figure.

    Raises:
        InputError: A run has no such joint, or nothing in that time.
        EnvironmentLacksError: matplotlib is not installed.
    """
    figure_of = _figure_class()
    for name, run in runs.items():
        if joint not in run.joints:
            raise InputError("--joint", f"'{joint}'", f"one of {', '.join(run.joints)}, of {name}")
    times = [run.cycle["t"][fault_windows.running_mask(run)] for run in runs.values()]
    known = np.concatenate(times)
    if span is None:
        span = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    if not ((known >= span[0]) & (known <= span[1])).any() or span[0] >= span[1]:
        raise InputError("--span", f"{span[0]:g} to {span[1]:g} s", "a time of the run")
    figure = figure_of(figsize=(7.0, 7.2), layout="constrained")
    rows = figure.subplots(4, 1, sharex=True)
    for k, (label, run) in enumerate(runs.items()):
        colour = (_OWN, *_OTHERS)[k % (1 + len(_OTHERS))]
        tail = f" {label}" if len(runs) > 1 else ""
        _error(rows[0], run, joint, span, label if tail else "error", colour)
        _effectiveness(rows[1], run, run.joints.index(joint), span, colour, tail)
        _torque(rows[2], run, joint, span, colour, tail)
        _residual(rows[3], run, joint, span, colour, tail)
    _mark_faults(rows, runs, joint, span)
    labels = ("tracking error (mrad)", "effectiveness", "torque (Nm)", "residual (Nm)")
    for axes, text in zip(rows, labels, strict=True):
        axes.set_ylabel(text)
        axes.grid(alpha=0.25)
        if axes.get_legend_handles_labels()[1]:
            axes.legend(loc="best", fontsize=8, framealpha=0.85, ncols=2)
    rows[0].set_title(title or joint, fontsize=10)
    rows[-1].set_xlabel("t (s)")
    rows[-1].set_xlim(*span)
    figure.align_ylabels(rows)
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
        with matplotlib.rc_context({"svg.hashsalt": "dftc_rt", "pdf.fonttype": 42}):
            figure.savefig(path, dpi=160, metadata=dates[suffix])
    except OSError as error:
        raise InputError(str(path), f"cannot be written: {error.strerror}") from None


def _figure_class() -> type[Figure]:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise EnvironmentLacksError(
            "matplotlib is not installed", "pip install 'dftc_rt[figures]'"
        ) from None
    return Figure


def _error(
    axes: Axes, run: Run, joint: str, span: tuple[float, float], label: str, colour: str
) -> None:
    if joint not in run.joints:
        return
    mask = _shown(run, span)
    error = tracking_error(run)[mask, run.joints.index(joint)] * 1e3
    _line(axes, run.cycle["t"][mask], error, colour, label)


def _effectiveness(
    axes: Axes, run: Run, i: int, span: tuple[float, float], colour: str = _OWN, tail: str = ""
) -> None:
    mask = _shown(run, span)
    t = run.cycle["t"][mask]
    mean, std = run.cycle["rho_hat"][mask, i], run.cycle["rho_std"][mask, i]
    if np.isfinite(mean + std).any():
        kept = extremes(std, _POINTS)
        low, high = ((mean + sign * 2 * std)[kept] for sign in (-1, 1))
        axes.fill_between(t[kept], low, high, color=colour, alpha=0.2, label=f"± 2σ{tail}")
    _line(axes, t, mean, colour, f"ρ̂{tail}")
    rho = fault_windows.rho_at(run, t)
    if rho is not None:
        dark = colour if tail else "0.3"
        axes.plot(t, rho[:, i], color=dark, linewidth=1.0, linestyle="--", label=f"ρ (true){tail}")


def _torque(
    axes: Axes, run: Run, joint: str, span: tuple[float, float], colour: str, tail: str
) -> None:
    mask, i = _shown(run, span), run.joints.index(joint)
    t = run.cycle["t"][mask]
    if not tail:
        _line(axes, t, run.cycle["tau_law"][mask, i], _OTHERS[1], "law")
    _line(axes, t, run.cycle["tau_cmd"][mask, i], colour if tail else _OTHERS[0], f"sent{tail}")
    if run.rig is not None and not tail:
        within = fault_windows.within(run.rig["t"], [span])
        applied = run.rig["tau_applied"][within, i]
        _line(axes, run.rig["t"][within], applied, "0.3", "applied", "--")


def _residual(
    axes: Axes, run: Run, joint: str, span: tuple[float, float], colour: str, tail: str
) -> None:
    mask, i = _shown(run, span), run.joints.index(joint)
    t = run.cycle["t"][mask]
    _line(axes, t, run.cycle["residual"][mask, i], colour, f"residual{tail}")
    threshold = residual_threshold(run)
    if threshold is not None:
        red = colour if tail else _OTHERS[2]
        _line(axes, t, threshold[mask, i], red, f"threshold{tail}", ":")
        _line(axes, t, -threshold[mask, i], red, None, ":")


def _mark_faults(
    rows: Sequence[Axes], runs: Mapping[str, Run], joint: str, span: tuple[float, float]
) -> None:
    """Shade what lies behind the first run's faults on this joint."""
    run = next(iter(runs.values()))
    given = fault_windows.faults_of(fault_windows.scenario_of(run))
    for fault in fault_windows.with_onsets(given, run):
        start, end = max(fault.start_s, span[0]), min(fault.end_s, span[1])
        if fault.joint == joint and start < end:
            for axes in rows:
                axes.axvspan(start, end, color=_OTHERS[2], alpha=0.07, linewidth=0)


def _shown(run: Run, span: tuple[float, float]) -> fault_windows.Mask:
    return fault_windows.running_mask(run) & fault_windows.within(run.cycle["t"], [span])


def _line(
    axes: Axes, t: Any, values: Any, colour: str, label: str | None, style: str = "-"
) -> None:
    """A thinned curve; nothing when it has no number."""
    if np.isfinite(values).any():
        kept = extremes(values, _POINTS)
        axes.plot(t[kept], values[kept], color=colour, linewidth=1.1, linestyle=style, label=label)
