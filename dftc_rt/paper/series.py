"""The curves of the figures as CSV, one file a figure, 100 samples a second.

The head names every column with its unit; what the paper calls x_i1 is ``q<i>`` here.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dftc_rt.errors import InputError
from dftc_rt.paper import observers
from dftc_rt.paper.closed_loop import Solution
from dftc_rt.paper.figures import PER_EXAMPLE, estimates, name
from dftc_rt.paper.right_hand_side import E1O, E2O, QD, U_CMD, VD
from dftc_rt.paper.runs import Drawn, fault_free, slug

F64 = NDArray[np.float64]


def write_all(curves: Mapping[str, Solution], drawn: Drawn, folder: Path) -> list[Path]:
    """Write the series of all figures; return the files.

    Args:
        curves: Solutions by :func:`dftc_rt.paper.runs.slug`.
        drawn: What the figures show.
        folder: Where the files go; it is there.

    Raises:
        InputError: A file cannot be written.
    """
    files = []
    for example in drawn.examples:
        healthy = curves[slug(fault_free(example, drawn.epsilon))]
        first = PER_EXAMPLE * (example - 1) + 1
        columns = (
            tracking(healthy),
            tracking(curves[slug(drawn.faulty(example, "none"))]),
            identification(healthy),
            effectiveness(estimates(curves, drawn, example)),
            tracking(curves[slug(drawn.faulty(example, drawn.gain))]),
        )
        for number, each in enumerate(columns, start=first):
            path = folder / f"{name(number)}.csv"
            write(path, each)
            files.append(path)
    return files


def tracking(solution: Solution) -> dict[str, F64]:
    """Positions, velocities, references, errors, torques and ρ_1, by column."""
    columns = {"t (s)": solution.t}
    for i in range(2):
        n = i + 1
        columns |= {
            f"q{n} (rad)": solution.q[:, i],
            f"q{n}_desired (rad)": solution.signals[:, QD, i],
            f"error{n} (rad)": solution.error(i),
            f"v{n} (rad/s)": solution.v[:, i],
            f"v{n}_desired (rad/s)": solution.signals[:, VD, i],
            f"u{n} (Nm)": solution.signals[:, U_CMD, i],
        }
    return columns | {"rho1 (1)": solution.rho}


def identification(solution: Solution) -> dict[str, F64]:
    """Errors of the identifier, by column."""
    columns = {"t (s)": solution.t}
    for i in range(2):
        columns[f"e{i + 1}1o (rad)"] = solution.signals[:, E1O, i]
        columns[f"e{i + 1}2o (rad/s)"] = solution.signals[:, E2O, i]
    return columns


def effectiveness(read_in: Mapping[str, Solution]) -> dict[str, F64]:
    """ρ_1 and all its estimates, by column; NaN where a run ended early."""
    longest = max(read_in.values(), key=lambda solution: len(solution.t))
    columns = {"t (s)": longest.t, "rho1 (1)": longest.rho}
    for observer in observers.NAMES:
        column = np.full(len(longest.t), np.nan)
        estimate = read_in[observer].estimate(observer)
        column[: len(estimate)] = estimate
        columns[f"rho1_hat_{observer} (1)"] = column
    return columns


def write(path: Path, columns: Mapping[str, F64]) -> None:
    """Write columns of equal length with nine digits.

    Raises:
        InputError: The file cannot be written.
    """
    rows = np.column_stack(list(columns.values()))
    try:
        with path.open("w", encoding="utf-8", newline="") as stream:
            np.savetxt(stream, rows, "%.9g", ",", header=",".join(columns), comments="")
    except OSError as error:
        raise InputError(str(path), f"cannot be written: {error.strerror}") from None
