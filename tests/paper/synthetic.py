"""Solutions and measures made up by hand: rules and drawings are tested without a solver."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dftc_rt.paper import observers
from dftc_rt.paper.closed_loop import Solution
from dftc_rt.paper.examples import EXAMPLES
from dftc_rt.paper.measures import Measures
from dftc_rt.paper.right_hand_side import QD, SIGNALS
from dftc_rt.paper.runs import Drawn, carried, shown, slug, standard
from dftc_rt.paper.variant import Variant

QUIET = Measures((1e-3, 1e-3), (2e-3, 2e-3), (1e-3, 1e-3), (2e-3, 2e-3), 1e-4, 1e-3, {})


def solution(variant: Variant, step_s: float = 1e-2, **changed: Any) -> Solution:
    """A run that follows sin t and estimates ρ without any error."""
    example = EXAMPLES[variant.example]
    t = np.arange(round(example.duration_s / step_s) + 1) * step_s
    signals = np.zeros((len(t), SIGNALS, 2))
    signals[:, QD, 0], signals[:, QD, 1] = np.sin(t), 0.5 * np.cos(t)
    rho = example.effectiveness(t) if variant.fault else np.ones(len(t))
    names = tuple(reading.name for reading in carried(variant, variant.epsilon))
    estimates = np.repeat(rho[:, None], len(names) * 2, axis=1).reshape(len(t), len(names), 2)
    made = Solution(
        example, variant, t, signals[:, QD, :].copy(), np.zeros((len(t), 2)), signals, estimates,
        rho, np.zeros(4), 1, None, names,
    )  # fmt: skip
    return replace(made, **changed)


def curves(drawn: Drawn) -> dict[str, Solution]:
    """Solutions of everything that is drawn."""
    return {slug(v): solution(v) for n in drawn.examples for v in shown(drawn, n)}


def measures(example: int, drawn: Drawn | None = None) -> dict[str, Measures]:
    """Measures of runs in which every joint tracks and every estimate is right."""
    drawn = drawn or Drawn()
    exact = replace(QUIET, rho_rmse=dict.fromkeys(observers.NAMES, 1e-3))
    variants = standard(example, drawn.epsilon) + shown(drawn, example)
    return {slug(variant): exact for variant in variants}
