"""Random search over the settings of the baselines, the same budget for each law.

    python -m tests.benchmarks.tune_baselines --candidates 30 --workers 2

Scenarios, search space and objective are below; docs/baselines.md has a table that this made. The
nominal feedback gains λ, k, the gain stage and the decision are the same for all laws and not
searched. ``--evaluate`` runs every law as it ships on motion that the search has not seen;
``--thresholds`` asks fault-free runs for the thresholds of the two laws that have CUSUMs.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Final, Literal

import numpy as np

from dftc_rt.analysis.faults import running_mask
from dftc_rt.analysis.metrics import evaluate, tracking_error
from dftc_rt.calibration import thresholds
from dftc_rt.calibration.replayed import replay
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.control import laws, signals
from dftc_rt.control.baselines.momentum import Momentum
from dftc_rt.control.dftc import Dftc
from dftc_rt.controller import prepare
from dftc_rt.dynamics.select import local_terms
from tests.benchmarks.result import Result, Table, show

Value = float | str
SKIP_S: Final = 2.0
ALARMS_PER_HOUR: Final = 0.1
LOST_MRAD: Final = 1000.0
"""What a run counts that does not go to its end."""


@dataclass(frozen=True)
class Range:
    """One setting to search: a range, on a log scale or a linear one, or names."""

    low: float = 0.0
    high: float = 0.0
    scale: Literal["log", "linear", "names"] = "log"
    names: tuple[str, ...] = ()

    def draw(self, rng: np.random.Generator) -> Value:
        """One value."""
        if self.scale == "names":
            return str(rng.choice(self.names))
        if self.scale == "linear":
            return float(f"{rng.uniform(self.low, self.high):.3g}")
        return float(f"{math.exp(rng.uniform(math.log(self.low), math.log(self.high))):.3g}")

    def __str__(self) -> str:
        if self.scale == "names":
            return " or ".join(self.names)
        return f"{self.low:g} to {self.high:g}, {self.scale}"


SPACE: Final[Mapping[str, Mapping[str, Range]]] = {
    "momentum": {
        "momentum_bandwidth": Range(20.0, 400.0),
        "momentum_memory_s": Range(0.01, 0.5),
        "momentum_gate": Range(scale="names", names=("attributed", "always")),
    },
    "eso": {
        "eso_ratio": Range(0.5, 20.0),
        "eso_model": Range(scale="names", names=("none", "split")),
        "eso_velocity": Range(scale="names", names=("estimated", "measured")),
    },
    "adaptive": {
        "gamma_theta": Range(300.0, 3e5),
        "dead_zone_theta": Range(0.0, 0.02, "linear"),
    },
}

UNKNOWN: Final = ("rig.plant.payload_kg=0.02", "rig.plant.coulomb_fraction=0.002")
"""What a calibration may leave: the laws are tuned on a robot that is not quite their model."""

_LOSSES: Final = {
    "panda_shoulder_loss": (
        '{joint="panda_joint2", kind="loss", start_s=3.0, effectiveness=0.5}',
        '{joint="panda_joint4", kind="sine", start_s=4.0, mean=0.8, amplitude=0.2, '
        "omega_rad_s=3.0}",
    ),
    "ur5_elbow_loss": (
        '{joint="shoulder_lift_joint", kind="loss", start_s=3.0, end_s=5.0, effectiveness=0.6}',
        '{joint="elbow_joint", kind="ramp", start_s=4.0, to=0.6, over_s=1.0}',
    ),
}


def runs(seed: int, seconds: float, exact: bool) -> list[tuple[str, list[str]]]:
    """Scenarios and their overrides; ``seed`` is that of noise and reference."""
    unknown = () if exact else UNKNOWN
    return [
        (name, [f"seed={seed}", f"reference.seed={seed}", f"duration_s={seconds}",
                f"fault=[{', '.join(losses)}]", *unknown])
        for name, losses in _LOSSES.items()
    ]  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """One run: RMS error of all joints from 2 s on, and in the faults, mrad; its alarms."""

    rms: float
    peak: float
    rho_rmse: float
    delay_s: float
    false_alarms: int


def run_one(law: str, scenario: str, overrides: Sequence[str]) -> Outcome:
    """Simulate one run."""
    opened = open_session(scenario, [*overrides, f"control.law={law}"])
    run, outcome = run_simulation(opened, progress=False)
    late = running_mask(run) & (run.cycle["t"] > SKIP_S)
    found = evaluate(run)
    lost = outcome.end_state != "done"
    error = 1e3 * tracking_error(run)[late]
    joints = [found["joints"][fault["joint"]] for fault in found["faults"]]

    def mean(key: str) -> float:
        values = [joint[key] for joint in joints if joint[key] is not None]
        return float(np.mean(values)) if len(values) == len(joints) else math.nan

    return Outcome(
        LOST_MRAD if lost else float(np.sqrt(np.mean(error**2))),
        LOST_MRAD if lost else float(np.abs(error).max()),
        mean("rho_rmse"),
        mean("detection_delay_s"),
        sum(joint["false_alarms"] for joint in found["joints"].values()),
    )


def as_overrides(candidate: Mapping[str, Value]) -> list[str]:
    """A candidate as ``--set`` would have it."""
    return [f"control.gains.{key}={value}" for key, value in candidate.items()]


def candidates(law: str, count: int, seed: int) -> list[dict[str, Value]]:
    """As shipped, and draws from the space of the law."""
    rng = np.random.default_rng([seed, *law.encode()])
    drawn: list[dict[str, Value]] = [{}]
    return drawn + [
        {key: each.draw(rng) for key, each in SPACE[law].items()} for _ in range(count - 1)
    ]


def objective(outcomes: Sequence[Outcome]) -> float:
    """Geometric mean over the runs, mrad: robots of different size count alike."""
    return float(np.exp(np.mean(np.log([outcome.rms for outcome in outcomes]))))


def search(
    pool: ProcessPoolExecutor,
    law: str,
    count: int,
    seed: int,
    scenarios: Sequence[tuple[str, list[str]]],
) -> Table:
    """Try every candidate of a law; best first."""
    tried = candidates(law, count, seed)
    waiting = [
        [pool.submit(run_one, law, name, [*base, *as_overrides(each)]) for name, base in scenarios]
        for each in tried
    ]
    scored = []
    for each, futures in zip(tried, waiting, strict=True):
        outcomes = [future.result() for future in futures]
        scored.append((objective(outcomes), each, [outcome.rms for outcome in outcomes]))
        print(
            f"{law} {scored[-1][0]:9.3f} mrad  {each or 'as shipped'}", file=sys.stderr, flush=True
        )
    scored.sort(key=lambda item: item[0])
    header = (law, "objective, mrad", *(name for name, _ in scenarios))
    rows = [
        (", ".join(f"{k} {v}" for k, v in each.items()) or "as shipped", f"{score:.3f}",
         *(f"{value:.3f}" for value in parts))
        for score, each, parts in scored
    ]  # fmt: skip
    space = "; ".join(f"{key}: {value}" for key, value in SPACE[law].items())
    return Table(f"{law}, {count} candidates, searched {space}", header, rows)


def compare(pool: ProcessPoolExecutor, scenarios: Sequence[tuple[str, list[str]]]) -> list[Table]:
    """Every law as it ships."""
    names = [name for name in laws.NAMES if name != "paper"]
    waiting = {
        law: [pool.submit(run_one, law, name, base) for name, base in scenarios] for law in names
    }
    tables = []
    for index, (name, _) in enumerate(scenarios):
        rows = []
        for law in names:
            found = waiting[law][index].result()
            rows.append(
                (law, f"{found.rms:.3f}", f"{found.peak:.2f}", _or_dash(found.rho_rmse),
                 _or_dash(found.delay_s), found.false_alarms)
            )  # fmt: skip
        header = ("law", "RMS, mrad", "peak, mrad", "ρ̂ RMSE", "detection, s", "false alarms")
        tables.append(Table(name, header, rows))
    return tables


def fault_free_threshold(law: str, scenario: str, overrides: Sequence[str]) -> tuple[float, float]:
    """Largest CUSUM of a fault-free run, and the threshold for 0.1 false alarms an hour.

    Both are of the joint that asks for most. The log is fed to the law again, as ``dftc
    calibrate`` does, because a CUSUM is not logged.
    """
    opened = open_session(scenario, [*overrides, f"control.law={law}", "fault=[]"])
    run, outcome = run_simulation(opened, progress=False)
    assert outcome.end_state == "done", outcome.reason
    period, n = 1.0 / opened.scenario.executor.rate_hz, opened.robot.n
    found = prepare(opened.scenario, opened.robot).law
    terms = local_terms(opened.robot, opened.scenario.control.interconnection)
    if isinstance(found, Dftc):
        total = replay(found, terms, run.cycle, ("loss",)).state["loss"]
    else:
        assert isinstance(found, Momentum)
        rows = {i: run.cycle[name] for i, name in enumerate(signals.NAMES) if name in run.cycle}
        total = np.empty((len(run.cycle["t"]), n))
        rec = np.zeros((len(signals.NAMES), n))
        found.start(run.cycle["q"][0], run.cycle["v"][0])
        for k in range(len(total)):
            for row, values in rows.items():
                rec[row] = values[k]
            found.update(rec, terms.inertia, terms.bias)
            found.history[:, k % found.history.shape[1]] = run.cycle["tau_cmd"][k]
            total[k] = found.state["loss"]
    late = total[round(SKIP_S / period) :]
    wanted = ALARMS_PER_HOUR / n
    asked = [
        thresholds.threshold(thresholds.block_maxima(late[:, i], period), wanted) for i in range(n)
    ]
    return float(late.max()), max(asked)


def compare_thresholds(
    pool: ProcessPoolExecutor, scenarios: Sequence[tuple[str, list[str]]]
) -> Table:
    """CUSUMs of B1 beside those of the law ``dftc``."""
    waiting = [
        (law, name, pool.submit(fault_free_threshold, law, name, base))
        for law in ("dftc", "momentum")
        for name, base in scenarios
    ]
    rows = [
        (law, name, *(f"{value:.2f}" for value in future.result())) for law, name, future in waiting
    ]
    header = ("law", "scenario", "largest", "for 0.1 alarms/h")
    return Table("CUSUM of a loss, fault-free; threshold_loss is 15", header, rows)


def _or_dash(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.3f}"


def main() -> None:
    """Search, or compare, and print tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--candidates", type=int, default=30, help="for each law")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=301, help="of motion, noise and draws")
    parser.add_argument("--seconds", type=float, default=7.0, help="length of each run")
    parser.add_argument("--law", choices=sorted(SPACE), action="append", help="default: all")
    parser.add_argument("--evaluate", action="store_true", help="compare the laws as they ship")
    parser.add_argument("--exact", action="store_true", help="a robot that is its model")
    parser.add_argument("--thresholds", action="store_true", help="thresholds, fault-free")
    told = parser.parse_args()
    scenarios = runs(told.seed, told.seconds, told.exact)
    with ProcessPoolExecutor(told.workers, get_context("spawn")) as pool:
        if told.thresholds:
            tables = [compare_thresholds(pool, scenarios)]
        elif told.evaluate:
            tables = compare(pool, scenarios)
        else:
            tables = [
                search(pool, law, told.candidates, told.seed, scenarios)
                for law in told.law or SPACE
            ]
    show(Result("baselines", tables), sys.stdout)


if __name__ == "__main__":
    main()
