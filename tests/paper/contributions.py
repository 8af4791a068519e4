"""What the paper says it contributes, measured: how far one joint's fault reaches the others.

A run with the fault against the same run without it (its twin), with the gain (33) and without,
in continuous time and at 1 kHz over CAN. The tables of docs/theory.md:

    python -m tests.paper.contributions
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from dftc_rt.analysis.metrics import running_mask
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.log.run import Run
from dftc_rt.paper.closed_loop import solve
from dftc_rt.paper.examples import EXAMPLES
from dftc_rt.paper.observers import READINGS
from dftc_rt.paper.right_hand_side import QD, U_CMD
from dftc_rt.paper.variant import Variant

SETTLE_S = 0.5
"""RMS values begin this long after the fault, peaks with it; s."""

SCENARIOS: dict[str, list[str]] = {
    "paper_example1": [],
    "paper_example2": [],
    "panda_shoulder_loss": ["duration_s=12"],
    "ur5_elbow_loss": ["duration_s=12"],
}
"""With settings."""
LAWS: dict[str, list[str]] = {
    "dftc": [],
    "dftc, gain off": ["control.ftc=false"],
    "computed torque": ["control.law=computed_torque"],
}


@dataclass(frozen=True)
class Reach:
    """A run with the fault against its twin; pairs are (faulty joint, worst of the others).

    Attributes:
        error: RMS tracking error with the fault, mrad.
        error_twin: The same without it.
        moved: RMS of q - q of the twin, mrad.
        moved_peak: Its largest absolute value from the fault on.
        torque: RMS of the change of the command, Nm.
        torque_peak: Its largest absolute value from the fault on.
    """

    error: tuple[float, float]
    error_twin: tuple[float, float]
    moved: tuple[float, float]
    moved_peak: tuple[float, float]
    torque: tuple[float, float]
    torque_peak: tuple[float, float]


@dataclass(frozen=True)
class Trajectory:
    """Samples of a run: times (K,), s; positions, references, rad, and commands, Nm, (K, n)."""

    t: np.ndarray
    q: np.ndarray
    q_d: np.ndarray
    u: np.ndarray


def reach(run: Trajectory, twin: Trajectory, joint: int, fault_s: float) -> Reach:
    """Compare a run with its twin."""
    assert np.array_equal(run.t, twin.t)
    after, settled = run.t >= fault_s, run.t >= fault_s + SETTLE_S

    def worst(values: np.ndarray) -> tuple[float, float]:
        return float(values[joint]), float(np.delete(values, joint).max())

    def rms(x: np.ndarray) -> tuple[float, float]:
        return worst(np.sqrt(np.mean(x[settled] ** 2, axis=0)))

    def peak(x: np.ndarray) -> tuple[float, float]:
        return worst(np.abs(x[after]).max(axis=0))

    moved, torque = 1e3 * (run.q - twin.q), run.u - twin.u
    return Reach(
        rms(1e3 * (run.q - run.q_d)), rms(1e3 * (twin.q - twin.q_d)), rms(moved), peak(moved),
        rms(torque), peak(torque),
    )  # fmt: skip


@cache
def _solution(example: int, gain: str, fault: bool, rtol: float) -> Trajectory:
    along = [reading for reading in READINGS if reading.name == gain]
    variant = Variant(example, gain=gain, fault=fault)
    found = solve(variant, rtol=rtol, atol=1e-2 * rtol, readings=along)
    assert found.failed is None
    return Trajectory(found.t, found.q, found.signals[:, QD], found.signals[:, U_CMD])


def continuous(example: int, gain: str, rtol: float = 1e-7) -> Reach:
    """An example of the paper, printed law with tanh(s/0.01), in a stiff solver.

    Args:
        example: 1 or 2.
        gain: ``none``, the name of an observer, or ``true``: ρ u is then what it is without the
            fault, and what is left of a difference is the solver's.
        rtol: Relative tolerance.
    """
    run, twin = (_solution(example, gain, fault, rtol) for fault in (True, False))
    return reach(run, twin, 0, EXAMPLES[example].fault_s)


@cache
def recorded(scenario: str, *settings: str) -> Run:
    """A scenario through the product: drives, CAN, delay and noise, at 1 kHz."""
    run, outcome = run_simulation(open_session(scenario, list(settings)), progress=False)
    assert outcome.end_state == "done", outcome.reason
    return run


def trajectory(run: Run) -> Trajectory:
    """The part of a recorded run in which the controller follows its reference."""
    mask, cycle = running_mask(run), run.cycle
    return Trajectory(*(cycle[name][mask] for name in ("t", "q", "qd", "tau_cmd")))


def at_1_khz(scenario: str, law: str, *settings: str) -> Reach:
    """Compare a scenario with its twin under a law of :data:`LAWS`."""
    run = recorded(scenario, *settings, *LAWS[law])
    twin = recorded(scenario, *settings, *LAWS[law], "fault=[]")
    (fault,) = open_session(scenario, settings).scenario.fault
    joint = run.joints.index(fault.joint)
    return reach(trajectory(run), trajectory(twin), joint, fault.start_s)


def row(plant: str, law: str, found: Reach) -> str:
    """A line of the table."""
    cells = [plant, law]
    for k in range(2):
        cells.append(f"{found.error[k]:.2g} ({found.error_twin[k]:.2g})")
        cells.append(f"{found.moved[k]:.2g} / {found.moved_peak[k]:.2g}")
        cells.append(f"{found.torque[k]:.2g} / {found.torque_peak[k]:.2g}")
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Print the table."""
    heads = ("error (twin), mrad", "moved, mrad", "torque, Nm")
    titles = [f"{which}: {head}" for which in ("own", "others") for head in heads]
    print("| plant | law | " + " | ".join(titles) + " |")
    print("|---" * 8 + "|")
    for example in (1, 2):
        for gain in ("none", "desired", "true"):
            found = continuous(example, gain)
            print(row(f"example {example}, continuous", f"paper, gain {gain}", found), flush=True)
    for scenario, settings in SCENARIOS.items():
        for law in LAWS:
            print(row(scenario, law, at_1_khz(scenario, law, *settings)), flush=True)


if __name__ == "__main__":
    main()
