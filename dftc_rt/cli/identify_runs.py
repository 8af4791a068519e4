"""Fault-free motion for ``dftc identify``: to train on, and to hold out."""

from __future__ import annotations

import dataclasses
import itertools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from rich.console import Console

from dftc_rt.cli.calibrate import _from_log, _rescaled, _session
from dftc_rt.cli.session import Session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.config.calibration import Calibration
from dftc_rt.config.scenario import Scenario
from dftc_rt.errors import InputError
from dftc_rt.log.run import Run

SKIP_S: Final = 1.0
"""Left out after the blend-in, s."""
MOTIONS: Final = ((1.0, 1.0), (2.0, 0.5), (0.5, 2.0))
"""Amplitude and frequency of the runs, in those of the scenario, one after the other."""


def logged(
    log: Sequence[Path], opened: Session, calibration: Calibration | None
) -> tuple[list[Run], list[Run]]:
    """Runs to train on, and to hold out, with commands in the calibrated torque."""
    runs = [_from_log(path, opened) for path in log]
    if calibration is not None:
        kappa = np.array([joint.torque_constant for joint in calibration.joint])
        runs = [_rescaled(run, kappa) for run in runs]
    if len(runs) > 2:
        return runs[:-1], runs[-1:]
    # Cross-validation needs two pieces of motion at least: there are three in a log.
    thirds = _thirds(runs[0])
    least = opened.scenario.reference.blend_s + SKIP_S + 5.0
    found = len(thirds[0].cycle["t"]) / opened.scenario.executor.rate_hz
    if found < least:
        raise InputError(str(log[0]), f"a third of it is {found:.1f} s", f"{least:g} s, or 3 logs")
    if len(runs) == 2:
        return thirds, runs[1:]
    print("dftc: one log: held out is its last third, not another motion", file=sys.stderr)
    return thirds[:2], thirds[2:]


def _thirds(run: Run) -> list[Run]:
    cuts = np.linspace(0, len(run.cycle["t"]), 4).astype(int)
    return [
        dataclasses.replace(run, cycle={k: v[a:b] for k, v in run.cycle.items()})
        for a, b in itertools.pairwise(cuts)
    ]


def simulated(
    opened: Session, count: int, seconds: float, seed: int, aim: str, console: Console
) -> list[Run]:
    """Fault-free runs, each on other motion: as the scenario's, wide and slow, small and fast."""
    found = []
    for k in range(count):
        scenario = _fault_free(opened.scenario, seed + k, seconds, MOTIONS[k % len(MOTIONS)])
        with console.status(f"run {k + 1} of {count} for {aim}, {seconds:g} s each"):
            run, outcome = run_simulation(_session(opened, scenario, None), progress=False)
        if outcome.end_state == "interrupted":
            raise KeyboardInterrupt
        if outcome.end_state != "done":
            where = f"run {k + 1} for {aim} ended in a {outcome.end_state}"
            raise InputError("identification", f"{where}: {outcome.reason}", "gentler motion")
        found.append(run)
    return found


def _fault_free(
    scenario: Scenario, seed: int, seconds: float, motion: tuple[float, float]
) -> Scenario:
    """The scenario without faults, on motion of its own."""
    replace = msgspec.structs.replace
    larger, faster = motion
    reference, control = scenario.reference, scenario.control
    amplitude, frequency = reference.amplitude_rad, reference.frequency_hz
    # Without a calibration the estimator may stop the robot: another law moves it.
    law = "dftc" if control.calibration is not None else "computed_torque"
    return replace(
        scenario,
        fault=(),
        seed=seed,
        duration_s=seconds,
        control=replace(control, law=law, ftc=False, local_terms="exact"),
        reference=replace(
            reference,
            kind="multisine",
            seed=seed,
            amplitude_rad=(
                tuple(larger * x for x in amplitude)
                if isinstance(amplitude, tuple)
                else larger * amplitude
            ),
            frequency_hz=(
                tuple(faster * x for x in frequency)
                if isinstance(frequency, tuple)
                else faster * frequency
            ),
        ),
        supervisor=replace(scenario.supervisor, rho_min=0.01),
    )
