"""What identified networks change, in numbers, a table and warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from dftc_rt.calibration.replayed import Replayed
from dftc_rt.config.identification import Identification
from dftc_rt.control.signals import ACTUATOR_LOSS
from dftc_rt.identification.train import Trained

F64 = NDArray[np.float64]
_Pair = tuple[float, float]
_WORSE: Final = 1.05  # ρ̂ is held where it cannot be seen: its RMS moves by itself


@dataclass(frozen=True, eq=False)
class Judged:
    """The observer on fault-free runs.

    Attributes:
        residual: RMS of y - φ, (n,), percent of the torque limit.
        rho: RMS of ρ̂ - 1, (n,).
        alarms: Entries into the verdict `actuator loss`, (n,).
    """

    residual: F64
    rho: F64
    alarms: NDArray[np.int64]


def judge(seen: Sequence[Replayed], skip: int, torque_limit: F64) -> Judged:
    """Statistics over several runs.

    Args:
        seen: Fault-free runs with the fields ``y_f``, ``phi_f`` and ``rho``.
        skip: Cycles left out at the start of each.
        torque_limit: (n,), Nm.
    """
    residual = np.vstack([x.state["y_f"][skip:] - x.state["phi_f"][skip:] for x in seen])
    rho = np.vstack([x.state["rho"][skip:] - 1.0 for x in seen])
    alarms = sum(
        np.count_nonzero(np.diff((x.verdict == ACTUATOR_LOSS).astype(int), axis=0) > 0, axis=0)
        for x in seen
    )
    return Judged(
        100.0 * np.sqrt(np.mean(residual**2, axis=0)) / torque_limit,
        np.sqrt(np.mean(rho**2, axis=0)),
        np.asarray(alarms, dtype=np.int64),
    )


class JointReport(msgspec.Struct, frozen=True, kw_only=True):
    """One joint; pairs are without the networks, and with them.

    Attributes:
        name: Joint name.
        cells: Cells of the grid that the training visited, and their number.
        position_percent: Part of the position range that it covered.
        velocity_percent: Its largest speed, of the velocity limit.
        ridge: Strength that cross-validation chose; null where nothing transferred.
        gain_network: Whether Ŵ_go was of use.
        training_percent: RMS of y - φ on the training motion, of the torque limit.
        held_out_percent: The same on motion that was held out.
        rho_rmse: RMS of ρ̂ - 1 there.
        false_alarms: Verdicts `actuator loss` there.
    """

    name: str
    cells: tuple[int, int]
    position_percent: float
    velocity_percent: float
    ridge: float | None
    gain_network: bool
    training_percent: _Pair
    held_out_percent: _Pair
    rho_rmse: _Pair
    false_alarms: tuple[int, int]


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """Of the whole robot.

    Attributes:
        robot: Its name.
        source: Where the motion came from.
        calibration: Fingerprint of the calibration in force, "" for none.
        grid: Points along position and velocity.
        training_s: Length of the training motion, s.
        held_out_s: Of the motion held out, s.
        joint: Every joint.
    """

    robot: str
    source: str
    calibration: str
    grid: tuple[int, int]
    training_s: float
    held_out_s: float
    joint: tuple[JointReport, ...]


def report(
    found: Identification,
    trained: Sequence[Trained],
    *,
    seconds: _Pair,
    training: tuple[Judged, Judged],
    held_out: tuple[Judged, Judged],
) -> Report:
    """Put the numbers together.

    Args:
        found: The networks.
        trained: How they came about, one a joint.
        seconds: Length of training and of held-out motion.
        training: The observer on the training motion, without and with the networks.
        held_out: The same on motion that was held out.
    """

    def pair(judged: tuple[Judged, Judged], name: str, i: int) -> _Pair:
        without, with_ = (getattr(each, name)[i] for each in judged)
        return float(without), float(with_)

    joints = tuple(
        JointReport(
            name=name,
            cells=(int(each.visited.sum()), each.visited.size),
            position_percent=100.0 * each.q_seen,
            velocity_percent=100.0 * each.v_seen,
            ridge=each.choice.strength if np.isfinite(each.choice.strength) else None,
            gain_network=each.choice.with_gain,
            training_percent=pair(training, "residual", i),
            held_out_percent=pair(held_out, "residual", i),
            rho_rmse=pair(held_out, "rho", i),
            false_alarms=(int(held_out[0].alarms[i]), int(held_out[1].alarms[i])),
        )
        for i, (name, each) in enumerate(zip(found.joints, trained, strict=True))
    )
    return Report(
        robot=found.robot, source=found.source, calibration=found.calibration, grid=found.grid,
        training_s=seconds[0], held_out_s=seconds[1], joint=joints,
    )  # fmt: skip


def show(found: Report, console: Console) -> None:
    """Print the table."""
    title = (
        f"{found.robot}: {found.training_s:g} s of training, {found.held_out_s:g} s held out, "
        f"grid {found.grid[0]} x {found.grid[1]}"
    )
    table = Table(title=title, box=None)
    for name, unit in (
        ("joint", ""), ("cells", "seen"), ("q, v", "% seen"), ("training", "limit %"),
        ("held out", "limit %"), ("ρ̂ off", "RMS"), ("false", "alarms"),
    ):  # fmt: skip
        first = name == "joint"
        table.add_column(f"{name}\n{unit}", justify="left" if first else "right", no_wrap=True)
    for joint in found.joint:
        table.add_row(
            joint.name,
            f"{joint.cells[0]}/{joint.cells[1]}",
            f"{joint.position_percent:.0f}, {joint.velocity_percent:.0f}",
            _arrow(joint.training_percent, ".2f"),
            _arrow(joint.held_out_percent, ".2f"),
            _arrow(joint.rho_rmse, ".3f"),
            _arrow(joint.false_alarms, "d"),
        )
    console.print(table)
    console.print("RMS of y - φ, of ρ̂ - 1, and verdicts 'actuator loss': without→with the networks")


def _arrow(pair: tuple[float, float], form: str) -> str:
    return f"{pair[0]:{form}}→{pair[1]:{form}}"


def warnings(found: Report) -> list[str]:
    """What the user has to know before using the file: lines."""
    lines = []
    for joint in found.joint:
        without, with_ = joint.held_out_percent
        if with_ > without:
            lines.append(
                f"{joint.name}: worse on motion it was not trained on: "
                f"{without:.3f} → {with_:.3f} % of the limit"
            )
        if joint.rho_rmse[1] > _WORSE * joint.rho_rmse[0]:
            lines.append(
                f"{joint.name}: ρ̂ further off on motion it was not trained on: "
                f"{joint.rho_rmse[0]:.3f} → {joint.rho_rmse[1]:.3f}"
            )
        if joint.false_alarms[1] > joint.false_alarms[0]:
            lines.append(
                f"{joint.name}: more false alarms on motion it was not trained on: "
                f"{joint.false_alarms[0]} → {joint.false_alarms[1]}"
            )
    nothing = [joint.name for joint in found.joint if joint.ridge is None]
    if len(nothing) == len(found.joint):
        lines.append("no joint learned anything that transfers: the networks are 0")
    elif nothing:
        lines.append(f"{', '.join(nothing)}: learned nothing that transfers; networks 0")
    return lines
