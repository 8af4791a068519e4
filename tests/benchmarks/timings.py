"""Timings of this program, each beside its floor, measured in the same run."""

from __future__ import annotations

import multiprocessing
import statistics
import time
from dataclasses import asdict
from typing import Any

import numpy as np

from dftc_rt.config.scenario import DriveTable, PlantTable
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.whole_body import WholeBody
from dftc_rt.errors import EnvironmentLacksError
from dftc_rt.rt.clock import NS, RealClock
from dftc_rt.rt.process import RealTime, last_core
from hil.faults import compile_faults
from hil.plants.rigid_body import RigidBodyPlant
from tests.benchmarks import cyclictest, mujoco_floor

PRIORITY = 80


def plant(name: str, cycles: int = 5000) -> dict[str, Any]:
    """Time of one cycle of the rig's plant over that of as many bare MuJoCo steps."""
    robot = load_robot(name)
    table = PlantTable()
    model = mujoco_floor.compile_model(
        robot.urdf_xml, robot.locked, 1e-3 / table.substeps, robot.armature
    )
    floor = mujoco_floor.measure(model, robot.home, table.substeps, cycles)
    faults = compile_faults((), robot.joints)
    held = WholeBody(robot).gravity(robot.home)
    blocks = []
    for _ in range(max(cycles // 100, 1) + 1):
        rig = RigidBodyPlant(
            robot, table, DriveTable(), faults, 1e-3, robot.home, np.zeros(robot.n)
        )
        rig.set_brakes(np.ones(robot.n, dtype=bool))
        rig.command[:] = rig.motor[:] = held
        start = time.perf_counter_ns()
        for _ in range(100):
            rig.advance(table.substeps)
        blocks.append((time.perf_counter_ns() - start) / 100e3)
    cycle_us = statistics.median(blocks[1:])  # the first block compiles
    return {
        "robot": name,
        "cycle_us": cycle_us,
        "mujoco_cycle_us": floor.cycle_us,
        "ratio": cycle_us / floor.cycle_us,
    }


def _wake_ups(core: int, seconds: int, results: multiprocessing.SimpleQueue[Any]) -> None:
    lateness = np.zeros(1000 * seconds)
    clock = RealClock()
    settings = RealTime(PRIORITY, core)
    tick = clock.now() + NS // 1000
    for k in range(lateness.size):
        clock.sleep_until(tick)
        lateness[k] = clock.now() - tick
        tick += NS // 1000
    settings.release()
    p50, p99 = np.percentile(lateness, [50, 99]) / 1e3
    found = {"p50_us": p50, "p99_us": p99, "max_us": lateness.max() / 1e3}
    results.put({"refused": settings.refused, **found})


def wake_ups(seconds: int) -> dict[str, Any]:
    """Lateness of the executor's clock at 1 kHz over that of cyclictest, on one core."""
    core = last_core()
    context = multiprocessing.get_context("spawn")
    results = context.SimpleQueue()
    child = context.Process(target=_wake_ups, args=(core, seconds, results))
    child.start()
    child.join()
    if child.exitcode != 0:
        raise RuntimeError(f"the measuring process ended with {child.exitcode}")
    ours = results.get()
    try:
        floor = cyclictest.measure(core, seconds, PRIORITY)
    except EnvironmentLacksError as error:
        return {**ours, "cyclictest": None, "reason": str(error)}
    ratios = {f"{p}_ratio": ours[f"{p}_us"] / getattr(floor, f"{p}_us") for p in ("p50", "p99")}
    return {**ours, "cyclictest": asdict(floor), **ratios}
