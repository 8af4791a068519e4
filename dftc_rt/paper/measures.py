"""What is measured on a simulated closed loop: the numbers that claims are judged by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.paper.closed_loop import Solution
from dftc_rt.paper.right_hand_side import E1O, E2O

F64 = NDArray[np.float64]

START_S: Final = 1.0
"""What happens before this time belongs to the start, s; the paper's Fig. 6 claims 1 s."""


@dataclass(frozen=True)
class Measures:
    """Numbers of one run. NaN where the run has no such time.

    Joints are in order. *Healthy* is from :data:`START_S` to the fault, or to the end of a run
    without; *faulty* is from the example's ``settle_s`` after the instant of the fault to the
    end, in a run without fault too, so that it can be compared.

    Attributes:
        healthy_rms: Tracking error e_i1, RMS, (2,), rad.
        healthy_largest: The same, largest magnitude, (2,), rad.
        faulty_rms: (2,), rad.
        faulty_largest: (2,), rad.
        identification_position: Largest |e_i1o| from :data:`START_S` on, rad, of all joints.
        identification_velocity: Largest |e_i2o|, rad/s, of all joints.
        rho_rmse: RMSE of ρ̂_1 in the faulty time, by observer that ran along.
        failed: What the solver said if it gave up; else None.
    """

    healthy_rms: tuple[float, ...]
    healthy_largest: tuple[float, ...]
    faulty_rms: tuple[float, ...]
    faulty_largest: tuple[float, ...]
    identification_position: float
    identification_velocity: float
    rho_rmse: dict[str, float]
    failed: str | None = None


def measure(solution: Solution) -> Measures:
    """Measure a solution."""
    example = solution.example
    onset = example.fault_s if solution.variant.fault else np.inf
    healthy = (solution.t >= START_S) & (solution.t < onset)
    faulty = solution.window(example.fault_s + example.settle_s)
    if solution.failed is not None:
        # What is left of a run that broke off is not the time that a claim is about.
        faulty = np.zeros_like(faulty)
    errors = [solution.error(joint) for joint in range(solution.q.shape[1])]
    started = solution.window(START_S)
    return Measures(
        healthy_rms=tuple(rms(e[healthy]) for e in errors),
        healthy_largest=tuple(largest(e[healthy]) for e in errors),
        faulty_rms=tuple(rms(e[faulty]) for e in errors),
        faulty_largest=tuple(largest(e[faulty]) for e in errors),
        identification_position=largest(solution.signals[started, E1O]),
        identification_velocity=largest(solution.signals[started, E2O]),
        rho_rmse={
            name: rms((solution.estimate(name) - solution.rho)[faulty])
            for name in solution.observers
        },
        failed=solution.failed,
    )


def rms(values: F64) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def largest(values: F64) -> float:
    """Largest magnitude; NaN of nothing."""
    return float(np.max(np.abs(values))) if values.size else float("nan")
