"""``dftc calibrate``: fault-free motion to load, friction and decision thresholds."""

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
from rich.table import Table

from dftc_rt.calibration import build, regression, residuals, signals, thresholds
from dftc_rt.calibration.replayed import replay
from dftc_rt.cli import session
from dftc_rt.cli.output import check_output
from dftc_rt.cli.session import Session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.config.calibration import Calibration, check_joints, load_calibration
from dftc_rt.config.load import from_text
from dftc_rt.config.scenario import Scenario
from dftc_rt.control.dftc import Dftc
from dftc_rt.controller import prepare
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.select import local_terms
from dftc_rt.errors import InputError
from dftc_rt.log.reader import read
from dftc_rt.log.run import Run
from dftc_rt.rt.supervisor import FOLLOWING

F64 = NDArray[np.float64]

_FIRST_SEED = 1001  # of the references of calibration runs, far from those people choose
_ANOMALIES_PER_ALARM = 10.0  # an anomaly only starts a compensation that is right anyway
_LEAST_FLOOR = 1e-3  # of the torque limit: three steps of a drive that counts in per mille
_SKIP_S = 1.0  # after the blend
_CUSUMS = {
    "threshold_anomaly": ("loss", "excess", "more", "less"),
    "threshold_loss": ("loss",),
}


def calibrate(
    scenario: str | Path,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    log: Sequence[Path] = (),
    runs: int = 3,
    seconds: float = 30.0,
    false_alarms_per_hour: float = 0.1,
    set_: Sequence[str] = (),
    json: bool = False,
) -> int:
    """Find a robot's load, friction, armature, torque constants and decision thresholds.

    Without --log, fault-free runs of the scenario are simulated: some for the model, as many
    on other motion for the statistics of what it leaves. With --log they are read.

    Example::

        dftc calibrate panda_shoulder_loss -o panda.toml
        dftc hil panda_shoulder_loss --set control.calibration=panda.toml

    Args:
        scenario: Scenario file, or the name of a shipped one.
        output: Calibration file to write.
        log: Fault-free log of a real robot, instead of simulated runs; may be repeated.
        runs: Simulated runs for the model, and again for the statistics.
        seconds: Length of each, s.
        false_alarms_per_hour: Rate to which the CUSUM thresholds are set, whole robot;
            anomalies may come ten times as often.
        set_: Override a key, ``a.b=value``; may be repeated.
        json: Print one JSON object on stdout.

    Returns:
        Exit code.

    Raises:
        InputError: Something in the scenario or a log is wrong, or there is too little motion.
    """
    check_output(output)
    if output.exists() and output.stat().st_size:
        load_calibration(output)  # something else than a calibration is not replaced
    _check_numbers(runs, seconds, false_alarms_per_hour)
    opened = session.open_session(scenario, set_)
    given = [_from_log(path, opened) for path in log]
    console = Console(stderr=True)
    if given:
        source = ", ".join(str(path) for path in log)
        model_runs = given if len(given) == 1 else given[:-1]
        if len(given) == 1:
            print("dftc: one log: its own fit is what the statistics are of", file=sys.stderr)
    else:
        source = f"simulated, {opened.scenario.name}"
        model_runs = _simulated(opened, runs, seconds, None, console)
    period = 1.0 / opened.scenario.executor.rate_hz
    moved = [_motion(opened, run, period) for run in model_runs]
    fit = regression.fit(opened.robot, moved, opened.robot.torque_limit)
    spent = sum(len(run.cycle["t"]) for run in model_runs) * period
    model = build.calibration_of(opened.robot, fit, source, spent)
    kappa = np.array([joint.torque_constant for joint in model.joint])
    checked = (
        [_rescaled(given[-1], kappa)]
        if given
        else _simulated(opened, runs, seconds, model, console)
    )
    # On a log the other joints were where they were, not where this calibration would hold them.
    where = "measured" if given else opened.scenario.control.interconnection
    found = _statistics(opened, model, checked, where, false_alarms_per_hour, period)
    output.write_text(build.to_toml(found), encoding="utf-8")
    if json:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        _show(found, Console(file=sys.stdout))
        print(f"wrote {output}")
    _warn(found)
    return 0


def _check_numbers(runs: int, seconds: float, rate: float) -> None:
    if not 1 <= runs <= 100:
        raise InputError("--runs", f"found {runs}", "1 to 100")
    if not 5.0 <= seconds <= 3600.0:
        raise InputError("--seconds", f"found {seconds:g}", "5 to 3600")
    if not 0.0 < rate <= 1000.0:
        raise InputError("--false-alarms-per-hour", f"found {rate:g}", "more than 0, at most 1000")


def _simulated(
    opened: Session, runs: int, seconds: float, model: Calibration | None, console: Console
) -> list[Run]:
    """Fault-free runs: computed torque for the model, then the law itself with that model."""
    found = []
    for k in range(runs):
        seed = _FIRST_SEED + k + (0 if model is None else runs)
        scenario = _fault_free(opened.scenario, seed, seconds, model)
        aim = "the model" if model is None else "the statistics"
        with console.status(f"run {k + 1} of {runs} for {aim}, {seconds:g} s each"):
            run, outcome = run_simulation(_session(opened, scenario, model), progress=False)
        if outcome.end_state == "interrupted":
            raise KeyboardInterrupt
        if outcome.end_state != "done":
            where = f"run {k + 1} for {aim} ended in a {outcome.end_state}"
            raise InputError("calibration", f"{where}: {outcome.reason}", "gentler motion")
        found.append(run)
    return found


def _fault_free(
    scenario: Scenario, seed: int, seconds: float, model: Calibration | None
) -> Scenario:
    """The scenario without faults, on motion of its own."""
    replace = msgspec.structs.replace
    control = replace(
        scenario.control,
        law="computed_torque" if model is None else "dftc",
        ftc=False,
        calibration=None,
        identification=None,
        local_terms="exact",
    )
    return replace(
        scenario,
        fault=(),
        seed=seed,
        duration_s=seconds,
        control=control,
        reference=replace(scenario.reference, kind="multisine", seed=seed),
        supervisor=replace(scenario.supervisor, rho_min=0.01),
    )


def _session(opened: Session, scenario: Scenario, model: Calibration | None) -> Session:
    """The same robot in another scenario; its reference is made smaller until it fits."""
    replace = msgspec.structs.replace
    for _ in range(8):
        try:
            parts = prepare(scenario, opened.robot, model)
            return Session(scenario, opened.text, opened.robot, parts, opened.cycle, opened.rig)
        except InputError as error:
            if error.where != "reference":
                raise
            amplitude = scenario.reference.amplitude_rad
            smaller = (
                tuple(0.7 * x for x in amplitude)
                if isinstance(amplitude, tuple)
                else 0.7 * amplitude
            )
            scenario = replace(
                scenario, reference=replace(scenario.reference, amplitude_rad=smaller)
            )
    raise InputError("reference", "no amplitude fits the limits", "a home pose away from limits")


def _rescaled(run: Run, factor: F64) -> Run:
    """The run with its commands in other units: times ``factor`` (n,)."""
    return dataclasses.replace(run, cycle={**run.cycle, "tau_cmd": run.cycle["tau_cmd"] * factor})


def _from_log(path: Path, opened: Session) -> Run:
    """A log while the robot was under control, its commands in nominal torque."""
    run = _nominal(path, read(path), opened)
    if run.joints != opened.robot.joints:
        found = "joints " + ", ".join(run.joints)
        raise InputError(str(path), found, ", ".join(opened.robot.joints))
    if run.rig is not None and bool((run.rig["fault"] > 0).any()):
        raise InputError(str(path), "a fault is active in it", "a fault-free log")
    t = run.cycle["t"]
    period = 1.0 / opened.scenario.executor.rate_hz
    if len(t) < 2 or abs(float(np.median(np.diff(t))) - period) > 0.01 * period:
        raise InputError(str(path), "another cycle time", f"{1e3 * period:g} ms")
    running = np.flatnonzero(np.isin(run.cycle["state"], FOLLOWING))
    if not running.size:
        raise InputError(str(path), "the robot was never under control", "a run")
    rows = slice(int(running[0]), int(running[-1]) + 1)
    least = opened.scenario.reference.blend_s + _SKIP_S + 3.0
    if (rows.stop - rows.start) * period < least:
        found = f"{(rows.stop - rows.start) * period:.2f} s under control"
        hint = "control.law=computed_torque records where the estimator would stop"
        raise InputError(str(path), found, f"more than {least:g} s; {hint}")
    if bool((np.diff(t[rows]) > 1.5 * period).any()):
        raise InputError(str(path), "cycles are missing", "a log without skipped cycles")
    if bool((run.cycle["age"][rows] > 0).any()):
        raise InputError(str(path), "answers are missing", "a log in which every joint answered")
    return dataclasses.replace(run, cycle={k: v[rows] for k, v in run.cycle.items()})


def _nominal(path: Path, run: Run, opened: Session) -> Run:
    """Undo the torque constants of the calibration that the log was recorded with."""
    if not run.scenario:
        return run
    used = from_text(run.scenario).control.calibration
    if used is None:
        return run
    try:
        earlier = load_calibration(used)
    except InputError as error:
        what = f"recorded with a calibration that cannot be read: {error}"
        raise InputError(str(path), what, "that file, or a log recorded without one") from None
    check_joints(earlier, opened.robot.name, opened.robot.joints, used)
    kappa = np.array([joint.torque_constant for joint in earlier.joint])
    return _rescaled(run, 1.0 / kappa)


def _motion(opened: Session, run: Run, period: float) -> signals.Motion:
    robot = opened.robot
    delay = np.array([joint.delay_cycles for joint in robot.joint_config], dtype=np.int64)
    law = prepare(
        msgspec.structs.replace(
            opened.scenario,
            control=msgspec.structs.replace(
                opened.scenario.control, law="dftc", identification=None
            ),
        ),
        robot,
    ).law
    assert isinstance(law, Dftc)
    lag = law.storage.parameters["torque_lag_s"]
    torque = signals.delivered(run.cycle["tau_cmd"], period, delay, lag)
    skip = opened.scenario.reference.blend_s + _SKIP_S
    return signals.motion(run.cycle["q"], run.cycle["v"], torque, period, skip)


def _statistics(
    opened: Session,
    model: Calibration,
    checked: Sequence[Run],
    interconnection: Any,
    rate: float,
    period: float,
) -> Calibration:
    """Residuals of the estimator on motion that was not fitted, and thresholds from them."""
    robot, n = opened.robot, opened.robot.n
    skip = round((opened.scenario.reference.blend_s + _SKIP_S) / period)
    fields = ("y_f", "phi_f", "loss", "excess", "more", "less")

    def replayed(calibration: Calibration) -> tuple[list[Any], Robot, Dftc]:
        scenario = _fault_free(opened.scenario, 0, 10.0, calibration)
        parts = prepare(scenario, robot, calibration)
        assert isinstance(parts.law, Dftc)
        terms = local_terms(parts.robot, interconnection)
        out = [replay(parts.law, terms, run.cycle, fields) for run in checked]
        return out, parts.robot, parts.law

    seen, _, law = replayed(model)
    limit = np.asarray(law.joints.torque_limit)
    bandwidth = law.storage.parameters["bandwidth"]

    def joined(pick: Any, i: int) -> F64:
        return np.concatenate([pick(k)[skip:, i] for k in range(len(checked))])

    spreads, held_out = [], []
    for i in range(n):
        residual = joined(lambda k: seen[k].state["y_f"] - seen[k].state["phi_f"], i)
        spreads.append(
            residuals.spread(
                residual,
                joined(lambda k: seen[k].inertia, i),
                joined(lambda k: seen[k].bias, i),
                joined(lambda k: checked[k].cycle["ad"], i),
                joined(lambda k: checked[k].cycle["v"], i),
                float(bandwidth[i]),
                period,
                _LEAST_FLOOR * float(limit[i]),
            )
        )
        held_out.append(100.0 * float(np.sqrt(np.mean(residual**2))) / float(limit[i]))
    spread_only = build.with_statistics(model, spreads, limit, held_out, [{}] * n, rate)
    seen, _, _ = replayed(spread_only)
    chosen = []
    for i in range(n):
        own = {}
        for name, sums in _CUSUMS.items():
            worst = np.concatenate(
                [
                    thresholds.block_maxima(
                        np.max([each.state[s][skip:, i] for s in sums], axis=0), period
                    )
                    for each in seen
                ]
            )
            wanted = rate / n * (_ANOMALIES_PER_ALARM if name == "threshold_anomaly" else 1.0)
            own[name] = thresholds.threshold(worst, wanted)
        chosen.append(own)
    return build.with_statistics(model, spreads, limit, held_out, chosen, rate)


def _show(found: Calibration, console: Console) -> None:
    table = Table(title=f"{found.robot}: {found.seconds:g} s, {found.source}", box=None)
    for name, unit in zip(
        ("joint", "viscous", "Coulomb", "offset", "armature", "torque const.", "left"),
        ("", "Nm s/rad", "Nm", "Nm", "kg m²", "", "% of limit"),
        strict=True,
    ):
        first = name == "joint"
        table.add_column(f"{name}\n{unit}", justify="left" if first else "right", no_wrap=first)
    for joint, left in zip(found.joint, found.held_out_percent, strict=True):
        table.add_row(
            joint.name,
            *(
                "nominal"
                if key in joint.not_excited
                else f"{getattr(joint, key):.3g} ± {getattr(joint, key + '_std'):.1g}"
                for key in regression.FRICTION
            ),
            f"{left:.2f}",
        )
    console.print(table)
    for link in found.link:
        console.print(f"link of {link.joint}: {link.mass_kg:.3f} ± {link.mass_std_kg:.3f} kg")


def _warn(found: Calibration) -> None:
    for joint in found.joint:
        if joint.not_excited:
            what = ", ".join(joint.not_excited).replace("_", " ")
            print(
                f"dftc: {joint.name}: the motion did not determine {what}; kept nominal",
                file=sys.stderr,
            )
