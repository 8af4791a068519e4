"""``dftc identify``: fault-free motion to frozen networks of the identifier."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from cyclopts import Parameter
from numpy.typing import NDArray
from rich.console import Console

from dftc_rt.calibration.replayed import Replayed, replay
from dftc_rt.cli import identify_report, identify_runs, session
from dftc_rt.cli.output import check_output
from dftc_rt.cli.session import Session
from dftc_rt.config.calibration import Calibration, load_calibration
from dftc_rt.config.identification import (
    Identification,
    fingerprint,
    load_identification,
    save_identification,
)
from dftc_rt.control.dftc import Dftc
from dftc_rt.controller import prepare
from dftc_rt.dynamics.select import local_terms
from dftc_rt.errors import InputError
from dftc_rt.identification.regressors import Basis, Samples
from dftc_rt.identification.train import Grid, Trained, train
from dftc_rt.log.run import Run

F64 = NDArray[np.float64]

_FIRST_SEED = 2001  # of the references, far from those of `dftc calibrate`
_HELD_OUT_SEED = 3001
_WIDTH = 1.0
_FIELDS = ("y_f", "phi_f", "rho")


def identify(
    scenario: str | Path,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    log: Sequence[Path] = (),
    runs: int = 6,
    seconds: float = 30.0,
    grid_q: int = 5,
    grid_v: int = 41,
    set_: Sequence[str] = (),
    json: bool = False,
) -> int:
    """Train the identifier's networks on the healthy robot, and freeze them.

    They learn what the model, with the scenario's calibration if it has one, leaves of each
    joint's torque, as a function of that joint's own position and velocity. What that is worth on
    motion they were not trained on is measured and printed.

    Example::

        dftc identify panda_shoulder_loss -o panda.npz --set control.calibration=panda.toml
        dftc simulate my_arm.toml      # with both files in its table [control]

    Args:
        scenario: Scenario file, or the name of a shipped one.
        output: Identification file to write.
        log: Fault-free log of a real robot, instead of simulated runs; may be repeated. The last
            one is not trained on; of a single one, its last third.
        runs: Simulated runs to train on; half as many are held out.
        seconds: Length of each, s.
        grid_q: Points of the grid along each joint's range of position.
        grid_v: Points along its range of velocity.
        set_: Override a key, ``a.b=value``; may be repeated.
        json: Print one JSON object on stdout.

    Returns:
        Exit code.

    Raises:
        InputError: Something in the scenario or a log is wrong, or there is too little motion.
    """
    check_output(output)
    if output.exists() and output.stat().st_size:
        load_identification(output)  # something else than an identification is not replaced
    _check_numbers(runs, seconds, grid_q, grid_v)
    opened = session.open_session(scenario, set_, identified=False)
    calibration = _calibration(opened)
    blank = _blank(opened, calibration, (grid_q, grid_v))
    prepare(opened.scenario, opened.robot, calibration, blank)  # refuses what could not use it
    console = Console(stderr=True)
    if log:
        given, held_out = identify_runs.logged(log, opened, calibration)
    else:
        given = identify_runs.simulated(opened, runs, seconds, _FIRST_SEED, "training", console)
        held_out = identify_runs.simulated(
            opened, -(-runs // 2), seconds, _HELD_OUT_SEED, "checking", console
        )
    where = "measured" if log else opened.scenario.control.interconnection
    with console.status("replaying the runs through the observer"):
        before = [_replayed(opened, run, calibration, blank, where) for run in given]
        trained = _train(opened, given, before, calibration, blank)
        source = ", ".join(str(path) for path in log) or f"simulated, {opened.scenario.name}"
        found = dataclasses.replace(
            blank,
            w_fo=np.stack([each.w_fo for each in trained]),
            w_go=np.stack([each.w_go for each in trained]),
            visited=np.stack([each.visited for each in trained]),
            source=source[:500],
            seconds=_seconds(opened, given),
        )
        report = _report(opened, given, held_out, calibration, where, before, found, trained)
    save_identification(output, found)
    if json:
        sys.stdout.write(msgspec.json.encode(report).decode() + "\n")
    else:
        identify_report.show(report, Console(file=sys.stdout))
        print(f"wrote {output}")
    for line in identify_report.warnings(report):
        print(f"dftc: {line}", file=sys.stderr)
    return 0


def _check_numbers(runs: int, seconds: float, grid_q: int, grid_v: int) -> None:
    if not 2 <= runs <= 100:
        raise InputError("--runs", f"found {runs}", "2 to 100")
    if not 5.0 <= seconds <= 3600.0:
        raise InputError("--seconds", f"found {seconds:g}", "5 to 3600")
    for name, points in (("--grid-q", grid_q), ("--grid-v", grid_v)):
        if not 1 <= points <= 99:
            raise InputError(name, f"found {points}", "1 to 99")


def _calibration(opened: Session) -> Calibration | None:
    path = opened.scenario.control.calibration
    return None if path is None else load_calibration(path)


def _law(
    opened: Session, calibration: Calibration | None, found: Identification | None
) -> tuple[Dftc, Any]:
    """The law ``dftc`` of the scenario without faults or a gain, and its robot."""
    replace = msgspec.structs.replace
    scenario = opened.scenario
    control = replace(scenario.control, law="dftc", ftc=False, local_terms="exact")
    parts = prepare(replace(scenario, control=control, fault=()), opened.robot, calibration, found)
    assert isinstance(parts.law, Dftc)
    return parts.law, parts.robot


def _blank(
    opened: Session, calibration: Calibration | None, points: tuple[int, int]
) -> Identification:
    """Networks that have learned nothing, on the grid over each joint's own range."""
    joints = _law(opened, calibration, None)[0].joints
    shape = (opened.robot.n, points[0] * points[1])
    return Identification(
        robot=opened.robot.name,
        joints=tuple(opened.robot.joints),
        grid=points,
        width=_WIDTH,
        q_range=np.column_stack([joints.q_lower, joints.q_upper]),
        v_range=joints.velocity_limit.copy(),
        w_fo=np.zeros(shape),
        w_go=np.zeros(shape),
        visited=np.zeros(shape, dtype=bool),
        interconnection=opened.scenario.control.interconnection,
        calibration=fingerprint(calibration),
    )


def _replayed(
    opened: Session,
    run: Run,
    calibration: Calibration | None,
    found: Identification,
    interconnection: Any,
) -> Replayed:
    law, robot = _law(opened, calibration, found)
    return replay(law, local_terms(robot, interconnection), run.cycle, _FIELDS)


def _skip_s(opened: Session) -> float:
    return opened.scenario.reference.blend_s + identify_runs.SKIP_S


def _seconds(opened: Session, runs: Sequence[Run]) -> float:
    return sum(len(run.cycle["t"]) for run in runs) / opened.scenario.executor.rate_hz


def _train(
    opened: Session,
    runs: Sequence[Run],
    seen: Sequence[Replayed],
    calibration: Calibration | None,
    blank: Identification,
) -> list[Trained]:
    law, _ = _law(opened, calibration, blank)
    par, centres = law.storage.parameters, law.storage.centres
    period = 1.0 / opened.scenario.executor.rate_hz
    out = []
    for i in range(opened.robot.n):
        grid = Grid(
            Basis(centres[i], float(par["inv_width1"][i]), float(par["inv_width2"][i])),
            (float(blank.q_range[i, 0]), float(blank.q_range[i, 1])),
            float(blank.v_range[i]),
            blank.grid,
        )
        samples = [
            Samples(
                run.cycle["q"][:, i],
                run.cycle["v"][:, i],
                each.inertia[:, i],
                each.state["y_f"][:, i],
                each.state["phi_f"][:, i],
                float(par["alpha"][i]),
            )
            for run, each in zip(runs, seen, strict=True)
        ]
        limit = float(law.joints.torque_limit[i])
        out.append(train(samples, grid, limit, period, _skip_s(opened)))
    return out


def _report(
    opened: Session,
    given: Sequence[Run],
    held_out: Sequence[Run],
    calibration: Calibration | None,
    where: Any,
    before: Sequence[Replayed],
    found: Identification,
    trained: Sequence[Trained],
) -> identify_report.Report:
    """What the networks change, by the observer itself."""
    blank = dataclasses.replace(found, w_fo=0 * found.w_fo, w_go=0 * found.w_go)
    limit = np.asarray(_law(opened, calibration, None)[0].joints.torque_limit)
    skip = round(_skip_s(opened) * opened.scenario.executor.rate_hz)

    def judged(runs: Sequence[Run], networks: Identification) -> identify_report.Judged:
        seen = [_replayed(opened, run, calibration, networks, where) for run in runs]
        return identify_report.judge(seen, skip, limit)

    return identify_report.report(
        found,
        trained,
        seconds=(_seconds(opened, given), _seconds(opened, held_out)),
        training=(identify_report.judge(before, skip, limit), judged(given, found)),
        held_out=(judged(held_out, blank), judged(held_out, found)),
    )
