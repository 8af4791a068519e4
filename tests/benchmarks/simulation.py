"""Speed of ``dftc simulate`` over its floors: as many bare forward dynamics, nothing else.

A cycle is one control period of 1 ms: controller, frames, emulated drives, four substeps
of the plant, and the record. Its floors are four bare ``pin.aba`` calls and four bare
``mj_step`` calls of the same robot.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dftc_rt.config.scenario import DriveTable, PlantTable
from dftc_rt.dynamics.robot import Robot, load_robot
from dftc_rt.dynamics.whole_body import WholeBody
from hil.faults import compile_faults
from hil.plants.rigid_body import RigidBodyPlant
from tests.benchmarks import bare_calls, mujoco_floor
from tests.benchmarks.closed_loop import simulate
from tests.benchmarks.interleaved import Samples, measure, ratio
from tests.benchmarks.result import Aim, Result, Table

SCENARIO = "panda_shoulder_loss"
SUBSTEPS = PlantTable().substeps
_VARIANTS = {
    "closed loop, exact, logged": ("exact", True),
    "closed loop, exact": ("exact", False),
    "closed loop, tabulated, logged": ("tabulated", True),
    "closed loop, tabulated": ("tabulated", False),
}
_ABA, _MUJOCO = f"{SUBSTEPS} x pin.aba", f"{SUBSTEPS} x mj_step"
_PLANT = f"plant alone, {SUBSTEPS} substeps"


def _plant(robot: Robot) -> Callable[[int], None]:
    """Return a function that moves the rig's plant from home, torque held, cycle by cycle."""
    plant = RigidBodyPlant(
        robot, PlantTable(), DriveTable(), compile_faults((), robot.joints), 1e-3,
        robot.home, np.zeros(robot.n),
    )  # fmt: skip
    plant.set_brakes(np.ones(robot.n, dtype=bool))
    held = WholeBody(robot).gravity(robot.home)

    def run(cycles: int) -> None:
        plant.q[:], plant.v[:] = robot.home, 0.0
        plant.command[:] = plant.motor[:] = held
        for _ in range(cycles):
            plant.advance(SUBSTEPS)

    return run


def run(quick: bool = False) -> Result:
    """Measure.

    Args:
        quick: One short round, to see that it works.

    Raises:
        EnvironmentLacksError: MuJoCo is not installed.
    """
    seconds, rounds, calls = (0.3, 1, 100) if quick else (4.0, 7, 2000)
    robot = load_robot("panda")
    model = mujoco_floor.compile_model(
        robot.urdf_xml, robot.locked, 1e-3 / SUBSTEPS, robot.armature
    )
    floors = {
        _ABA: bare_calls.aba(robot, SUBSTEPS),
        _MUJOCO: mujoco_floor.steps(model, robot.home, SUBSTEPS),
        _PLANT: _plant(robot),
    }
    found = {name: Samples() for name in (*_VARIANTS, *floors)}
    with tempfile.TemporaryDirectory(prefix="dftc-benchmark-") as folder:
        for number in range(rounds):
            for name, (terms, logged) in _VARIANTS.items():
                log = Path(folder) / f"{number}.mcap" if logged else None
                settings = [f"duration_s={seconds}", "fault=[]", f"control.local_terms={terms}"]
                timed = simulate(SCENARIO, settings, log)
                found[name].add(timed.cycles, timed.wall_ns, timed.cpu_ns)
                if log is not None:
                    log.unlink()
            for name, samples in measure(floors, 3, calls).items():
                found[name].wall.append(samples.median)
                found[name].cpu.append(samples.cpu_median)
    aba, mujoco = found[_ABA], found[_MUJOCO]
    rows = [
        (
            name, samples.cpu_median, min(samples.cpu), samples.median, samples.least,
            ratio(samples.cpu, aba.cpu), ratio(samples.cpu, mujoco.cpu),
            ratio(samples.wall, mujoco.wall),
        )
        for name, samples in found.items()
    ]  # fmt: skip
    header = (
        "panda, 1 kHz", "cpu median", "cpu min", "wall median", "wall min",
        f"cpu / {_ABA}", f"cpu / {_MUJOCO}", f"wall / {_MUJOCO}",
    )  # fmt: skip
    what = f"processor time a cycle over {_MUJOCO}"
    return Result(
        "simulation",
        [Table("Simulation: time of one control cycle, us", header, rows)],
        [
            Aim(f"{name}: {what}", "<=", 1.25, ratio(found[name].cpu, mujoco.cpu))
            for name in _VARIANTS
            if _VARIANTS[name][1]
        ],
        [
            f"{rounds} rounds of {seconds:g} s simulated, all rows in turn; ratios are medians "
            "over rounds; set-up is not counted"
        ],
    )
