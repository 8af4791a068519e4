"""The ten figures, as PNG and SVG; the same curves give the same bytes.

Source: [zhao2017] Figs. 1-10.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dftc_rt.errors import EnvironmentLacksError, InputError
from dftc_rt.paper import observers
from dftc_rt.paper.closed_loop import Solution
from dftc_rt.paper.right_hand_side import E1O, E2O, QD
from dftc_rt.paper.runs import Drawn, fault_free, loop_of, slug
from dftc_rt.paper.verdicts import IDENTIFIED, TRACKS_MRAD

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PER_EXAMPLE: Final = 5
_DPI: Final = 110
_DESIRED: Final = "0.25"
_OWN: Final = "#3b7dd8"
_PRINTED: Final = ("#d1495b", "#e0862b")
_OURS: Final = ("#3b7dd8", "#3a9d5d", "#9467bd")
_ZOOM: Final = 2.0  # half-height of the lowest row, in units of the rule's bound


def name(figure: int) -> str:
    """Name of a figure's files without ending."""
    return f"figure{figure:02d}"


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


def draw_all(curves: Mapping[str, Solution], drawn: Drawn, folder: Path) -> list[Path]:
    """Draw the figures of all examples; return the files.

    Args:
        curves: Solutions by :func:`dftc_rt.paper.runs.slug`.
        drawn: What is to be shown.
        folder: Where the files go; it is there.

    Raises:
        InputError: A file cannot be written.
    """
    from matplotlib import style

    with style.context("default"):  # whatever the user's matplotlibrc says
        return [path for n in drawn.examples for path in _draw(curves, drawn, n, folder)]


def _draw(curves: Mapping[str, Solution], drawn: Drawn, example: int, folder: Path) -> list[Path]:
    """Draw the five figures of an example."""
    files: list[Path] = []
    healthy = curves[slug(fault_free(example, drawn.epsilon))]
    without = curves[slug(drawn.faulty(example, "none"))]
    tolerant = curves[slug(drawn.faulty(example, drawn.gain))]
    first = PER_EXAMPLE * (example - 1) + 1
    figures = (
        tracking(healthy, "without a fault"),
        tracking(without, "under the fault, without the gain"),
        identification(healthy),
        effectiveness(estimates(curves, drawn, example)),
        tracking(tolerant, f"under the fault; gain: {gain_words(drawn.gain)}"),
    )
    for number, figure in enumerate(figures, start=first):
        figure.suptitle(f"Fig. {number}. {figure.get_suptitle()}", fontsize=10)
        files += save(figure, folder / name(number))
    return files


def gain_words(gain: str) -> str:
    """What drives the gain, in words."""
    words = {"none": "none", "true": "the true 1/ρ"}
    found = words.get(gain) or next(r.title for r in observers.READINGS if r.name == gain)
    return found.replace("`", "")


def estimates(curves: Mapping[str, Solution], drawn: Drawn, example: int) -> dict[str, Solution]:
    """For each observer the loop in which it is read."""
    return {
        each: curves[slug(drawn.faulty(example, loop_of(each, drawn)))] for each in observers.NAMES
    }


def tracking(solution: Solution, title: str) -> Figure:
    """Positions, tracking errors, and the errors as they are seen from near, of both joints."""
    figure, axes = _grid(3, 2)
    for i in range(2):
        top, middle, near = axes[0][i], axes[1][i], axes[2][i]
        top.plot(solution.t, solution.signals[:, QD, i], "--", color=_DESIRED, lw=1.2,
                 label=f"$x_{{{i + 1}1d}}$")  # fmt: skip
        top.plot(solution.t, solution.q[:, i], color=_OWN, lw=1.0, label=f"$x_{{{i + 1}1}}$")
        top.set_ylim(*_limits(solution, i))
        top.legend(loc="upper right", fontsize=7, ncols=2)
        top.set_title(f"joint {i + 1}", fontsize=9)
        error = solution.error(i)
        middle.plot(solution.t, error, color=_OWN, lw=1.0)
        middle.set_ylim(-1.1, 1.1)
        near.plot(solution.t, error * 1e3, color=_OWN, lw=0.8)
        near.set_ylim(-_ZOOM * TRACKS_MRAD, _ZOOM * TRACKS_MRAD)
        near.axhspan(-TRACKS_MRAD, TRACKS_MRAD, color="0.5", alpha=0.12, lw=0)
        for each, what in (
            (top, "position (rad)"), (middle, f"$e_{{{i + 1}1}}$ (rad)"),
            (near, f"$e_{{{i + 1}1}}$ (mrad)"),
        ):  # fmt: skip
            _time(each, solution)
            each.set_ylabel(what, fontsize=8)
        near.set_xlabel("t (s)", fontsize=8)
    return _titled(figure, solution, f"tracking {title}")


def identification(solution: Solution) -> Figure:
    """Errors of the identifier, position and velocity, of both joints."""
    figure, axes = _grid(3, 2)
    for i in range(2):
        rows = (
            (E1O, 1.0, (-0.5, 2.2), f"$e_{{{i + 1}1o}}$ (rad)"),
            (E2O, 1.0, (-2.2, 2.2), f"$e_{{{i + 1}2o}}$ (rad/s)"),
            (E2O, 1e3, (-2e3 * IDENTIFIED, 2e3 * IDENTIFIED), f"$e_{{{i + 1}2o}}$ (mrad/s)"),
        )
        for each, (signal, scale, limits, what) in zip(
            (axes[k][i] for k in range(3)), rows, strict=True
        ):
            each.plot(solution.t, scale * solution.signals[:, signal, i], color=_OWN, lw=1.0)
            each.set_ylim(*limits)
            each.set_ylabel(what, fontsize=8)
            _time(each, solution)
        bound = 1e3 * IDENTIFIED
        axes[2][i].axhspan(-bound, bound, color="0.5", alpha=0.12, lw=0)
        axes[0][i].set_title(f"joint {i + 1}", fontsize=9)
        axes[2][i].set_xlabel("t (s)", fontsize=8)
    return _titled(figure, solution, "identification error without a fault")


def effectiveness(read_in: Mapping[str, Solution]) -> Figure:
    """ρ_1 and its estimates: those of the paper's equations above, ours below."""
    figure, axes = _grid(2, 1)
    solution = read_in["desired"]
    for (each,), names, colours in (
        (axes[0], ("measured", "true_rho"), _PRINTED),
        (axes[1], ("desired", "fitted", "frozen"), _OURS),
    ):
        for observer, colour in zip(names, colours, strict=True):
            own = read_in[observer]
            each.plot(own.t, own.estimate(observer), color=colour, lw=1.0,
                      label=rf"$\hat\rho_1$, {gain_words(observer)}")  # fmt: skip
        each.plot(solution.t, solution.rho, "--", color=_DESIRED, lw=1.2, label=r"$\rho_1$")
        each.set_ylim(0.0, 1.45)  # room for the legend above
        each.set_yticks([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
        each.set_ylabel("effectiveness", fontsize=8)
        each.legend(loc="upper right", fontsize=7, ncols=2)
        _time(each, solution)
    axes[1][0].set_xlabel("t (s)", fontsize=8)
    return _titled(figure, solution, "effectiveness of joint 1 and its estimates")


def save(figure: Figure, stem: Path) -> list[Path]:
    """Save as PNG and SVG, without dates.

    Raises:
        InputError: A file cannot be written.
    """
    import matplotlib

    files = []
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # what has been laid out once stays so in both files
    for suffix, metadata in ((".png", {"Software": None}), (".svg", {"Date": None})):
        path = stem.with_suffix(suffix)
        try:
            with matplotlib.rc_context({"svg.hashsalt": "dftc_rt"}):
                figure.savefig(path, dpi=_DPI, metadata=metadata)
        except OSError as error:
            raise InputError(str(path), f"cannot be written: {error.strerror}") from None
        files.append(path)
    return files


def _grid(rows: int, columns: int) -> tuple[Figure, list[list[Axes]]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 1.75 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
    return figure, [list(row) for row in axes]


def _limits(solution: Solution, joint: int) -> tuple[float, float]:
    """Of the position: the reference and where the joint starts, with a margin."""
    desired = solution.signals[:, QD, joint]
    low, high = min(0.0, desired.min()), max(1.0, desired.max())
    return low - 0.2, high + 0.6  # room for the legend above


def _time(axes: Axes, solution: Solution) -> None:
    axes.set_xlim(0.0, solution.example.duration_s)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.25)
    if solution.variant.fault:
        axes.axvline(solution.example.fault_s, color="0.5", lw=0.8, ls=":")


def _titled(figure: Figure, solution: Solution, title: str) -> Figure:
    figure.suptitle(f"Example {solution.example.number}: {title}")
    return figure
