"""Regularisations of the printed law, each with values that follow from the step.

In the boundary layer the robust term is a feedback of slope a = (g/ĝ)(δ̂ S + ξ̂)/ε on s. Sampled
with the step h it is dead beat at h a = 1 and unstable from h a = 2 on. Every value below makes
h a = ½ where it can be made out in advance, a quarter of what is unstable:

- *layer*. While s is reached, (13), (14) keep (g/ĝ) s² + δ̂²/Γ_δ + ξ̂²/Γ_ξ (taken alone) constant,
  so they leave δ̂ + ξ̂ ≤ √((Γ_δ + Γ_ξ) ĝ/g) |s(0)| behind. It must also hold d, the part of ṡ that
  the law does not know: ε = 2 h max(√((Γ_δ + Γ_ξ) g/ĝ) |s(0)|, d).
- *dead zone*. In the layer |s| = d/a. Adaptation raises a until |s| is below the dead zone w:
  w = 2 h d.
- *leakage*. It ends the growth where (Γ_δ + Γ_ξ) |s| = σ (δ̂ + ξ̂), which is at
  a² = (Γ_δ + Γ_ξ) d (g/ĝ)/(σ ε): σ = 4 h² (Γ_δ + Γ_ξ) d (g/ĝ)/ε. For the weights 0.1 1/s, as in
  the law ``dftc``.
- *projection* of ĝ to [0.7, 1.4] of the joint's own 1/M_ii, as in the law ``dftc``; so g/ĝ is at
  most (M⁻¹)_ii M_ii/0.7.
- *saturation* at twice what the reference and the linear feedback of s(0) ask for, and no
  adaptation meanwhile.

The identifier takes the same ε, w and σ. The two gains of adaptation that act through u are those
of oscillators of frequency √Γ |u|, which an explicit step holds up to h Γ u² = l. Half of that,
at the torque limit, is Γ_go = l_2/(2 h u²) and Γ_ρ = l_2f/(2 h (ĝ u)²); or less, as printed.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import ReferenceTable
from dftc_rt.control import basis
from dftc_rt.control.settings import NUMBERS
from dftc_rt.dynamics.closed_form.plants import CLOSED_FORMS
from dftc_rt.paper.examples import EXAMPLES, IDENTIFIER_STATE, Q0
from dftc_rt.reference import Reference

F64 = NDArray[np.float64]
Scope = Literal["controller", "whole"]
SCOPES: Final[tuple[Scope, ...]] = ("controller", "whole")
"""The controller alone, or with identifier, observer and gain."""
Group = Literal["cumulative", "without", "factor", "other"]

STEPS_S: Final = (1e-3, 1e-4, 1e-5)
"""Steps of the study, s."""
LONG_S: Final = 200.0
"""Length of the runs at 1 ms, s: what grows without bound needs longer than the paper's runs."""
FIVE: Final = ("layer", "projection", "dead zone", "leakage", "saturation")
"""The regularisations, in the order in which they are added."""
FURTHER: Final = ("ρ̂ clipped", "Γ_ρ", "Γ_go")
"""What the whole needs besides: ρ̂ in [0.15, 1] before the gain, and gains for the step."""

PAIRS: Final = (("projection", "saturation"), ("dead zone", "leakage"))
"""What stands in for each other, left out together."""

_PRINTED: Final = {s.name: s.printed for s in NUMBERS}
_UNLIMITED: Final = 1e300
_LEAST, _MOST = 0.7, 1.4  # of 1/M_ii: the projection of the law `dftc`


def complete(scope: Scope) -> tuple[str, ...]:
    """All that is added, in order."""
    return FIVE if scope == "controller" else FIVE + FURTHER


@dataclass(frozen=True)
class Scales:
    """What the values are made of, (2,) each, from the example and its plant alone.

    Attributes:
        drift: d, largest |g u + (g/ĝ)(f̂ - q̈_d)| along the reference, u being the torque that
            follows it, ĝ projected, and the weights those of the start, rad/s².
        torque: Largest torque that the reference asks for, Nm.
        inertia: Largest M_ii along it, kg m².
        gain: Largest (M⁻¹)_ii along it, 1/(kg m²).
        s0: |s(0)|, rad/s: the larger of the two, for both.
    """

    drift: F64
    torque: F64
    inertia: F64
    gain: F64
    s0: F64

    @property
    def limit(self) -> F64:
        """Torque limit of *saturation*, (2,), Nm."""
        return 2.0 * (self.torque + self.inertia * _PRINTED["k"] * self.s0)


@functools.cache
def scales(number: int) -> Scales:
    """Return the scales of an example.

    Args:
        number: 1 or 2.
    """
    example = EXAMPLES[number]
    plant = CLOSED_FORMS[example.plant]
    motion = Reference(ReferenceTable(kind=example.reference, blend_s=0.0), np.zeros(2))
    desired = motion.table(np.arange(0.0, example.duration_s, 0.01))
    torque, mass = np.empty((len(desired), 2)), np.empty((len(desired), 2, 2))
    known = np.empty((len(desired), 2))
    sigma, centres, width = np.empty(7), basis.diagonal_centres(1)[0], _PRINTED["basis_width"]
    for k, (q, v, a) in enumerate(desired):
        plant.inverse_dynamics(q, v, a, torque[k])
        plant.mass_matrix(q, mass[k])
        for i in range(2):
            basis.gaussian(q[i], v[i], centres, 1.0 / width, 1.0 / width, sigma)
            known[k, i] = sigma @ np.array(example.w_f)  # Ŵ_f and Ŵ_g start equal
    inertia = np.diagonal(mass, axis1=1, axis2=2).max(axis=0)
    gain = np.diagonal(np.linalg.inv(mass), axis1=1, axis2=2)
    assumed = np.clip(known, _LEAST / inertia, _MOST / inertia)
    drift = gain * torque + gain / assumed * (known - desired[:, 2])
    q, v, _ = desired[0]
    s0 = np.abs(_PRINTED["lam"] * (np.array(Q0) - q) - v)
    return Scales(
        drift=np.abs(drift).max(axis=0),
        torque=np.abs(torque).max(axis=0),
        inertia=inertia,
        gain=gain.max(axis=0),
        s0=np.full(2, s0.max()),
    )


@dataclass(frozen=True)
class Case:
    """One run.

    Attributes:
        group: Table that it belongs to.
        example: 1 or 2.
        scope: The controller alone, or with identifier, observer and gain.
        step_s: Control period, s.
        on: Regularisations that are on.
        label: What is special about it.
        factors: Multiples of the values of a regularisation, by its name.
        gains: Further settings.
        duration_s: Length, s; None: the example's.
        law: ``paper``, or ``dftc`` as it ships.
        substeps: Steps of RK4 of the plant in one control period.
    """

    group: Group
    example: int
    scope: Scope
    step_s: float
    on: tuple[str, ...]
    label: str = ""
    factors: tuple[tuple[str, float], ...] = ()
    gains: dict[str, Any] = field(default_factory=dict)
    duration_s: float | None = None
    law: Literal["paper", "dftc"] = "paper"
    substeps: int = 4

    def settings(self) -> dict[str, Any]:
        """All gains that differ from the law's own, see docs/notation.md."""
        gains: dict[str, Any] = {"torque_lag_s": 0.0}
        if self.law == "paper":
            example = EXAMPLES[self.example]
            gains.update(
                w_f=example.w_f, w_g=example.w_f, w_fo=example.w_fo, w_go=example.w_go,
                x1o_offset=IDENTIFIER_STATE[0] - Q0[0], x2o_offset=IDENTIFIER_STATE[1],
            )  # fmt: skip
        if self.scope == "controller":
            gains.update(identifier="off", gamma_rho=0.0)
        return {**gains, **self.chosen()}

    def chosen(self) -> dict[str, Any]:
        """Those of them that belong to what is on, or are special to this run."""
        found: dict[str, Any] = {}
        for name in self.on:
            found.update(self._values(name, dict(self.factors).get(name, 1.0)))
        return {**found, **self.gains}

    def limit(self) -> F64:
        """Torque limit, (2,), Nm."""
        if "saturation" not in self.on and self.law == "paper":
            return np.full(2, _UNLIMITED)
        return scales(self.example).limit * dict(self.factors).get("saturation", 1.0)

    def _values(self, name: str, factor: float) -> dict[str, Any]:
        """Settings of one regularisation, its value times a factor."""
        scale, h = scales(self.example), self.step_s
        gamma = _PRINTED["gamma_delta"] + _PRINTED["gamma_xi"]
        ratio = scale.gain / (_LEAST / scale.inertia)
        reach = np.sqrt(gamma * ratio) * scale.s0
        layer = 2.0 * h * np.maximum(reach, scale.drift)
        values: dict[str, Any] = {}
        if name == "layer":
            values = {"layer": layer, "layer_o": layer}
        elif name == "projection":
            values = {"g_min": _LEAST / scale.inertia}
        elif name == "dead zone":
            zone = 2.0 * h * scale.drift
            values = {"dead_zone": zone, "dead_zone_o": zone}
        elif name == "leakage":
            leak = 4.0 * h * h * gamma * scale.drift * ratio / layer
            values = {"leak_delta": leak, "leak_xi": leak, "leak_o": leak}
            values.update(leak_f=np.full(2, 0.1), leak_g=np.full(2, 0.1))
        elif name == "saturation":
            return {"freeze_saturated": "on"}
        elif name == "ρ̂ clipped":
            values = {"rho_min": np.full(2, 0.15)}
        elif name == "Γ_ρ":
            pushed = _PRINTED["l2f"] / (2.0 * h * (scale.limit * _MOST / scale.inertia) ** 2)
            values = {"gamma_rho": np.minimum(_PRINTED["gamma_rho"], pushed)}
        elif name == "Γ_go":
            pushed = _PRINTED["l2"] / (2.0 * h * scale.limit**2)
            values = {"gamma_go": np.minimum(_PRINTED["gamma_go"], pushed)}
        scaled: dict[str, Any] = {key: (value * factor).tolist() for key, value in values.items()}
        if name == "projection":
            scaled["g_max"] = (np.maximum(_MOST, _LEAST * factor) / scale.inertia).tolist()
        elif name == "ρ̂ clipped":
            scaled["rho_max"] = 1.0
        return scaled


def cases(examples: Sequence[int] = (1, 2), *, quick: bool = False) -> list[Case]:
    """Every run of the study, in the order of its tables.

    Args:
        examples: Which examples.
        quick: Steps of 1 ms only, and neither factors nor other readings.
    """
    found: list[Case] = []
    for number, scope in itertools.product(examples, SCOPES):
        at_1khz = functools.partial(_at_1khz, number, scope)
        everything = complete(scope)
        for count in range(len(everything) + 1):
            found.append(at_1khz("cumulative", everything[:count]))
        for step, count in itertools.product(STEPS_S[1:], range(len(everything) + 1)):
            if not quick:
                case = Case("cumulative", number, scope, step, everything[:count], substeps=2)
                found.append(case)
        for left_out in [*((name,) for name in everything), *PAIRS]:
            on = tuple(name for name in everything if name not in left_out)
            found.append(at_1khz("without", on, ", ".join(left_out)))
        if quick:
            continue
        for name, factor in itertools.product(everything, (0.5, 2.0)):
            label, factors = f"{name} × {factor:g}", ((name, factor),)
            found.append(at_1khz("factor", everything, label, factors=factors))
        found += _others(number, scope)
    return found


def _at_1khz(
    number: int, scope: Scope, group: Group, on: tuple[str, ...], label: str = "", **rest: Any
) -> Case:
    """A case at 1 kHz, long enough for δ̂ and ξ̂ to grow out of bounds."""
    return Case(group, number, scope, STEPS_S[0], on, label, duration_s=LONG_S, **rest)


def _others(number: int, scope: Scope) -> list[Case]:
    """Other readings of one example."""
    other = functools.partial(_at_1khz, number, scope, "other")
    everything = complete(scope)
    if scope == "controller":
        slow = functools.partial(
            other, label="Γ_δ = Γ_ξ = 2 1/s", gains={"gamma_delta": 2.0, "gamma_xi": 2.0}
        )
        half = tuple((name, 0.5) for name in ("layer", "dead zone", "leakage"))
        at_one = "h a = 1: layer, dead zone, leakage × 0.5"
        return [
            other(("saturation",)),
            slow(()),
            slow(("projection",)),
            slow(("layer", "projection")),
            other(("layer", "projection", "dead zone")),
            other(("layer", "projection", "leakage")),
            other(everything, at_one, factors=half),
            other(FIVE[:-1], at_one, factors=half),
            other(everything, "plant in half the step", substeps=8),
        ]
    split = {"model": "split", "g_min": _LEAST, "g_max": _MOST, "identifier": "off"}
    split.update(dict.fromkeys(("w_f", "w_g", "w_fo", "w_go"), 0.0))
    normalised = {"observer": "gradient", "gamma_rho": 1000.0, "l2f": 60.0}
    return [
        other(everything, "(29) normalised", gains=normalised),
        other(everything, "(29) normalised; f̂, ĝ of the split", gains={**normalised, **split}),
        other((), "`dftc` as it ships", law="dftc"),
    ]
