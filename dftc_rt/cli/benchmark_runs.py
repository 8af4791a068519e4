"""Runs of ``dftc benchmark``: what a worker process does."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.analysis.metrics import evaluate
from dftc_rt.benchmark import negative
from dftc_rt.benchmark.cases import (
    VARIANTS,
    Group,
    fault_setting,
    law_settings,
    partner,
    run_settings,
)
from dftc_rt.benchmark.conditions import LOADED, RIG, ROBOTS
from dftc_rt.benchmark.measure import Drives, measure, torque_share
from dftc_rt.benchmark.negative import Item, item_settings, measure_negative
from dftc_rt.benchmark.rows import FaultRow, NegativeRow
from dftc_rt.cli.calibrate import calibrate
from dftc_rt.cli.session import Session, open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.config.calibration import Calibration, load_calibration
from dftc_rt.effectiveness import schedule
from dftc_rt.errors import InputError
from dftc_rt.log.run import Run

F64 = NDArray[np.float64]

_SMALLER: Final = 0.8
_TRIES: Final = 12


@dataclass(frozen=True)
class Finished:
    """A run that has come to its end.

    Attributes:
        opened: What was run.
        run: Its records.
        facts: End, times: columns of every row.
    """

    opened: Session
    run: Run
    facts: dict[str, Any]


def check_settings(robot: str, extra: Sequence[str]) -> None:
    """Refuse overrides that a robot's scenario does not take.

    Raises:
        InputError: A key or a value is wrong.
    """
    opened_session(robot, [*RIG, *extra])


def make_calibration(robot: str, output: str, runs: int, seconds: float) -> None:
    """Write the calibration of a robot, as ``dftc calibrate`` does.

    Args:
        robot: Key of :data:`dftc_rt.benchmark.conditions.ROBOTS`.
        output: File to write.
        runs: Simulated runs for the model, and again for the statistics.
        seconds: Length of each, s.
    """
    path = Path(output)
    fresh = path.with_suffix(".new")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        calibrate(ROBOTS[robot], output=fresh, runs=runs, seconds=seconds, set_=RIG)
    fresh.replace(path)


def fault_rows(
    group: Group,
    calibration: str,
    fingerprint: str,
    extra: Sequence[str],
    wanted: Sequence[tuple[str, str]],
    with_twin: bool,
) -> Iterator[FaultRow]:
    """Run a twin and the cases that share it.

    Args:
        group: Which.
        calibration: File.
        fingerprint: Of the rows.
        extra: Further overrides of the scenario.
        wanted: Kind and joint; joints that turn out to carry no load are left out.
        with_twin: Also give the rows of the twin.
    """
    known, base = base_settings(group, calibration, extra)
    twin, settings = fitting(group.robot, [*base, *run_settings(), "fault=[]"])
    drives = _drives(twin.opened, known)
    share = torque_share(twin.run, drives)
    joints = twin.run.joints
    loaded = [joint for joint, part in zip(joints, share, strict=True) if part > LOADED]
    if with_twin:
        yield from _twin_rows(group, fingerprint, twin, share)
    if twin.facts["end_state"] != "done":
        return
    for kind, joint in wanted:
        second = partner(loaded, joint) if kind == "two" and joint in loaded else ""
        if joint not in loaded or second is None:
            continue
        done = _simulated(group.robot, [*settings, fault_setting(kind, joint, second)])
        columns = measure(
            done.run, twin.run, joint, _true(done.opened, twin.run, joint), drives,
            VARIANTS[group.variant].gain,
        )  # fmt: skip
        yield FaultRow(
            id=group.case_id(kind, joint),
            kind=kind,
            joint=joint,
            second=second,
            loaded=True,
            torque_share=float(share[joints.index(joint)]),
            **columns,
            **names(group, fingerprint),
            **done.facts,
        )


def negative_rows(
    group: Group, calibration: str, fingerprint: str, extra: Sequence[str], items: Sequence[Item]
) -> Iterator[NegativeRow]:
    """Run items of the negative set.

    Args:
        group: Which.
        calibration: File.
        fingerprint: Of the rows.
        extra: Further overrides of the scenario.
        items: The items.
    """
    known, base = base_settings(group, calibration, extra)
    robot = opened_session(group.robot, [*base, "fault=[]"]).robot
    for item in items:
        found = item_settings(item, group.seed, robot.home, robot.lower, robot.upper)
        done, _ = fitting(group.robot, [*base, *found])
        drives = _drives(done.opened, known)
        columns = measure_negative(done.run, VARIANTS[group.variant].gain, drives.period_s)
        yield NegativeRow(
            id=negative.item_id(group, item.name),
            item=item.name,
            **columns,
            **names(group, fingerprint),
            **done.facts,
        )


def base_settings(
    group: Group, calibration: str, extra: Sequence[str]
) -> tuple[Calibration, list[str]]:
    """The calibration, and the overrides of every run of a group."""
    known = load_calibration(calibration)
    return known, [*RIG, *law_settings(group, known, calibration), *extra]


def names(group: Group, fingerprint: str) -> dict[str, Any]:
    """Columns that say which group a row is of."""
    return {
        "fingerprint": fingerprint,
        "robot": group.robot,
        "variant": group.variant,
        "interconnection": group.interconnection,
        "momentum_threshold": group.momentum_threshold,
        "draw": group.draw,
        "seed": group.seed,
    }


def _twin_rows(group: Group, fingerprint: str, twin: Finished, share: F64) -> Iterator[FaultRow]:
    """One row a joint: how much load it carries, and how it tracks when healthy."""
    found = evaluate(twin.run)["joints"]
    own = names(group, fingerprint)
    for i, (joint, each) in enumerate(found.items()):
        yield FaultRow(
            id=group.case_id("twin", joint),
            kind="twin",
            joint=joint,
            loaded=bool(share[i] > LOADED),
            torque_share=float(share[i]),
            rmse_twin_mrad=each["rmse_healthy_mrad"],
            false_alarms=each["false_alarms"],
            false_alarm_s=each["false_alarm_s"],
            **own,
            **twin.facts,
        )


def opened_session(robot: str, settings: Sequence[str]) -> Session:
    """The robot's scenario with overrides."""
    return open_session(ROBOTS[robot], settings)


def _same(opened: Session) -> Session:
    return opened


def fitting(
    robot: str, settings: Sequence[str], change: Callable[[Session], Session] = _same
) -> tuple[Finished, list[str]]:
    """Run with the reference made smaller until it fits the limits; with the settings used."""
    used = list(settings)
    for _ in range(_TRIES):
        try:
            return _simulated(robot, used, change), used
        except InputError as error:
            if error.where != "reference":
                raise
            used = _gentler(robot, used)
    raise InputError("reference", "no amplitude fits the limits", "a home pose away from limits")


def _gentler(robot: str, settings: Sequence[str]) -> list[str]:
    """The settings with a smaller amplitude, or poses nearer to the first."""
    import tomllib

    used = []
    seen = False
    for setting in settings:
        key, _, value = setting.partition("=")
        if key == "reference.amplitude_rad":
            setting, seen = f"{key}={_SMALLER * float(value)}", True
        elif key == "reference.positions_rad":
            poses = np.array(tomllib.loads(f"x={value}")["x"])
            setting, seen = f"{key}={(poses[0] + _SMALLER * (poses - poses[0])).tolist()}", True
        used.append(setting)
    if not seen:
        used.append(f"reference.amplitude_rad={_SMALLER * _amplitude(robot)}")
    return used


@cache
def _amplitude(robot: str) -> float:
    from dftc_rt.config.load import load_scenario
    from hil import SCENARIOS

    amplitude = load_scenario(ROBOTS[robot], (), SCENARIOS).scenario.reference.amplitude_rad
    return float(np.max(amplitude))


def _simulated(
    robot: str, settings: Sequence[str], change: Callable[[Session], Session] = _same
) -> Finished:
    started = time.process_time()
    opened = change(opened_session(robot, settings))
    run, outcome = run_simulation(opened, progress=False)
    if outcome.end_state == "interrupted":
        raise KeyboardInterrupt
    facts = {
        "end_state": outcome.end_state,
        "reason": outcome.reason,
        "simulated_s": len(run.cycle["t"]) / opened.scenario.executor.rate_hz,
        "cpu_s": time.process_time() - started,
    }
    return Finished(opened, run, facts)


def _drives(opened: Session, calibration: Calibration) -> Drives:
    return Drives.of(
        calibration,
        1.0 / opened.scenario.executor.rate_hz,
        [joint.delay_cycles for joint in opened.robot.joint_config],
        opened.scenario.rig.drive.torque_lag_s,
        opened.parts.torque_limit,
    )


def _true(opened: Session, twin: Run, joint: str) -> F64:
    """Effectiveness of a joint over the twin's time, (K,): a run may have been stopped before."""
    rho = schedule(opened.scenario.fault, opened.robot.joints)
    out = np.empty(opened.robot.n)
    index = opened.robot.joints.index(joint)
    found = np.empty(len(twin.cycle["t"]))
    for k, t in enumerate(twin.cycle["t"]):
        rho(float(t), out)
        found[k] = out[index]
    return found
