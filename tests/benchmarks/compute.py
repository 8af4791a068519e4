"""Time of the controller's computation in one cycle, as a multiple of one ``pin.rnea`` call.

What is timed is what the executor records as ``compute``: reference, local terms, law with
its estimators, supervisor. The parts are then called by themselves on the recorded cycles.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from dftc_rt.analysis.metrics import running_mask, tracking_error
from dftc_rt.control import signals
from dftc_rt.controller import joint_limits
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.tabulated import TabulatedTerms
from dftc_rt.log.run import Run
from dftc_rt.rt.supervisor import State, Supervisor
from tests.benchmarks import bare_calls
from tests.benchmarks.closed_loop import Timed, simulate
from tests.benchmarks.interleaved import Samples, measure, ratio
from tests.benchmarks.result import Aim, Result, Table

F64 = NDArray[np.float64]

SCENARIO = "panda_shoulder_loss"
AIMS = {"exact": 15.0, "tabulated": 5.0}
_RNEA = "pin.rnea"
_CALLS = 50  # a turn: short enough that most are not interrupted on a busy machine
_ENABLED = 0x0637  # a statusword: operation enabled


def run(quick: bool = False) -> Result:
    """Measure.

    Args:
        quick: One short round, to see that it works.
    """
    seconds, rounds, turns = (0.3, 1, 5) if quick else (4.0, 7, 60)
    robot = load_robot("panda")
    floor: list[float] = []
    recorded: dict[str, list[float]] = {terms: [] for terms in AIMS}
    last: dict[str, Timed] = {}
    for _ in range(rounds):
        for terms in AIMS:
            settings = [f"duration_s={seconds}", f"control.local_terms={terms}", "fault=[]"]
            last[terms] = simulate(SCENARIO, settings)
            found = last[terms].run
            compute = found.cycle["compute"][running_mask(found)]
            recorded[terms].append(float(np.median(compute)) * 1e6)
        blocks = measure({_RNEA: bare_calls.rnea(robot)}, 20, _CALLS)
        floor.append(blocks[_RNEA].median)
    parts = measure(
        {_RNEA: bare_calls.rnea(robot), **_parts(last["exact"])}, rounds * turns, _CALLS
    )
    rows: list[tuple[str | float | None, ...]] = [
        (terms, float(np.median(us)), min(us), ratio(us, floor), AIMS[terms])
        for terms, us in recorded.items()
    ]
    rows.append((_RNEA, float(np.median(floor)), min(floor), 1.0, None))
    return Result(
        "compute",
        [
            Table(
                "Compute: recorded by the executor each cycle of a simulation, us",
                ("panda", "median", "least", f"x {_RNEA}", "aim"),
                rows,
            ),
            _parts_table(parts),
            _error_table(last["exact"]),
            _tracking_table(last),
        ],
        [
            Aim(f"compute a cycle, {terms}, over one {_RNEA}", "<=", AIMS[terms], ratio(us, floor))
            for terms, us in recorded.items()
        ],
        [f"{rounds} rounds of {seconds:g} s simulated, rnea in between"],
    )


def _parts(timed: Timed) -> dict[str, Callable[[int], None]]:
    """Return what one update is made of, each replaying the recorded cycles."""
    opened, run = timed.opened, timed.run
    parts = opened.parts
    running = np.flatnonzero(running_mask(run))
    n = len(run.joints)
    rec = np.empty((len(running), len(signals.NAMES), n))
    for row, name in enumerate(signals.NAMES):
        rec[:, row] = run.cycle[name][running]
    recs = list(rec)
    q, v, desired = ([r[rows] for r in recs] for rows in (signals.Q, signals.V, _DESIRED))
    t = [k / opened.scenario.executor.rate_hz for k in range(len(recs))]
    table = _table(timed)
    status = np.full(n, _ENABLED, dtype=np.int64)
    supervisor = Supervisor(opened.scenario.supervisor, joint_limits(parts), 1e-3)
    no_emergency = np.zeros(n, dtype=np.int64)
    motion = np.empty((3, n))
    parts.law.start(q[0], v[0])
    parts.terms.update(q[0], v[0], *desired[0])
    inertia, bias = parts.terms.inertia.copy(), parts.terms.bias.copy()

    def each(one: Callable[[int], object]) -> Callable[[int], None]:
        at = itertools.cycle(range(len(recs)))

        def run(calls: int) -> None:
            for _ in range(calls):
                one(next(at))

        return run

    return {
        "reference": each(lambda k: parts.reference.sample(t[k], motion)),
        "local terms, exact": each(lambda k: parts.terms.update(q[k], v[k], *desired[k])),
        "local terms, tabulated": each(lambda k: table.update(k, q[k], v[k])),
        "law and estimators": each(lambda k: parts.law.update(recs[k], inertia, bias)),
        "supervisor": each(lambda k: supervisor.check(recs[k], status, no_emergency, State.RUN, 0)),
        "an empty call": each(lambda k: None),
    }


_DESIRED = slice(signals.QD, signals.AD + 1)


def _parts_table(parts: dict[str, Samples]) -> Table:
    rnea = parts[_RNEA]
    return Table(
        "Its parts, called by themselves, us",
        ("part", "median", "least", f"x {_RNEA}"),
        [
            (name, samples.median, samples.least, ratio(samples.wall, rnea.wall))
            for name, samples in parts.items()
        ],
    )


def _table(timed: Timed) -> TabulatedTerms:
    opened = timed.opened
    cycles = round(opened.scenario.duration_s * opened.scenario.executor.rate_hz)
    motion = opened.parts.reference.table(np.arange(cycles) / opened.scenario.executor.rate_hz)
    return TabulatedTerms(
        opened.robot, opened.scenario.control.interconnection,
        *(np.ascontiguousarray(motion[:, row]) for row in range(3)),
    )  # fmt: skip


def _error_table(timed: Timed) -> Table:
    """What tabulating costs, as far from the reference as the loop really was."""
    mask = running_mask(timed.run)
    offset_q = float(np.abs(tracking_error(timed.run)[mask]).max())
    offset_v = float(np.abs((timed.run.cycle["vd"] - timed.run.cycle["v"])[mask]).max())
    error = _table(timed).error(offset_q, offset_v, samples=500)
    limit = timed.opened.parts.torque_limit
    rows = [
        (joint, float(inertia), float(bias), float(bias / top) * 100)
        for joint, inertia, bias, top in zip(
            timed.run.joints, error.inertia, error.bias, limit, strict=True
        )
    ]
    return Table(
        f"Largest error of tabulated terms within {offset_q * 1e3:.2f} mrad and "
        f"{offset_v * 1e3:.1f} mrad/s of the reference",
        ("joint", "M_i, kg m2", "bias, Nm", "% of limit"),
        rows,
    )


def _tracking_table(timed: dict[str, Timed]) -> Table:
    def rmse(run: Run) -> Sequence[float]:
        error = tracking_error(run)[running_mask(run)]
        return [float(x) for x in np.sqrt(np.mean(error**2, axis=0)) * 1e3]

    runs = {terms: rmse(each.run) for terms, each in timed.items()}
    joints = timed["exact"].run.joints
    return Table(
        "What it does to tracking: RMSE, mrad",
        ("joint", *runs),
        [(joint, *(errors[i] for errors in runs.values())) for i, joint in enumerate(joints)],
    )
