"""The readings of the paper that :mod:`dftc_rt.paper.search` tries."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np

from dftc_rt.paper.search_integrators import Integrator
from dftc_rt.paper.variant import Act, Reading, Variant

SEED: Final = 20170
"""Seed of the random readings."""
DRAWS: Final = 24
"""Random readings."""

_DELTA, _XI, _DELTA_O = 500.0, 400.0, 500.0
_KNOWN: Final = {1: 1.0, 2: [1.0 / 0.9666, 1.0 / 0.1233]}  # g_i: 1/M_ii in the upright
_INVERSE: Final = {2: [4.4 / 0.9666, 4.4 / 0.1233]}  # (M⁻¹)_ii there


@dataclass(frozen=True)
class Candidate:
    """One reading of one example.

    Attributes:
        example: 1 or 2.
        group: What kind of reading it is.
        name: The reading in words; the same in both examples.
        integrator: How it is integrated.
        epsilon: ε of tanh(s/ε), rad/s; 0 is the exact sgn.
        robust: What becomes of δ̂, ξ̂, Ŵ_f, Ŵ_g under the fault.
        identifier: Whether the identifier goes on adapting under the fault.
        plant: Another plant than the example's.
        gains: Settings other than the printed ones.
        reading: How single equations and initial values are read.
    """

    example: int
    group: str
    name: str
    integrator: Integrator = field(default_factory=Integrator)
    epsilon: float = 0.01
    robust: Act = "on"
    identifier: Literal["adapt", "frozen"] = "frozen"
    plant: str | None = None
    gains: dict[str, Any] = field(default_factory=dict)
    reading: Reading = field(default_factory=Reading)

    def variant(self, gain: str, fault: bool) -> Variant:
        """What is simulated, with the gain from an observer, or ``none``."""
        return Variant(
            self.example, epsilon=self.epsilon, fault=fault, gain=gain, robust=self.robust,
            identifier=self.identifier, plant=self.plant, gains=self.gains, reading=self.reading,
        )  # fmt: skip


def space(quick: bool = False) -> list[Candidate]:
    """All candidates, in the order of the table.

    Args:
        quick: Only those that the tests run: :data:`QUICK`, in Example 2.
    """
    every = [c for group in (_numerics, _parameters, _fault, _equations, _combined, _random)
             for c in group()]  # fmt: skip
    if quick:
        return [c for c in every if c.example == 2 and c.name in QUICK]
    return every


QUICK: Final = ("as printed", "Euler 0.001 s, exact sgn", "δ̂, ξ̂, Ŵ removed at the fault",
                "Γ_δ, Γ_ξ = 0, Γ_f, Γ_g = 500, g_i known",
                "f_i, g_i, h_i known, Γ_δ, Γ_ξ = 0")  # fmt: skip


def _both(group: str, name: str, **changes: Any) -> list[Candidate]:
    """The same reading of both examples."""
    return [Candidate(example, group, name, **changes) for example in (1, 2)]


def _numerics() -> list[Candidate]:
    found = _both("numerics", "as printed")
    for epsilon in (1.0, 0.1, 0.001):
        found += _both("numerics", f"ε = {epsilon:g} rad/s", epsilon=epsilon)
    for kind, label in (("euler", "Euler"), ("rk4", "RK4")):
        for step in (1e-2, 1e-3, 1e-4, 1e-5):
            how = Integrator(kind, step)
            found += _both("numerics", f"{label} {step:g} s, exact sgn", integrator=how, epsilon=0)
            found += _both("numerics", f"{label} {step:g} s, ε = 0.01 rad/s", integrator=how)
    ode45 = Integrator("ode45", evaluations=1_000_000)
    found += _both("numerics", "ode45, exact sgn", integrator=ode45, epsilon=0)
    found += _both("numerics", "ode45, ε = 0.01 rad/s", integrator=ode45)
    found += _both("numerics", "ode45, ε = 0.1 rad/s", integrator=ode45, epsilon=0.1)
    through = {"g_min": -np.inf}
    found += _both("numerics", "ĝ may pass through 0", gains=through)
    found += _both("numerics", "ĝ may pass through 0, ode45, exact sgn", gains=through,
                   integrator=ode45, epsilon=0)  # fmt: skip
    found += _both("numerics", "ĝ ≥ 0.1", gains={"g_min": 0.1})
    return found


def _parameters() -> list[Candidate]:
    found: list[Candidate] = []
    for factor in (0.1, 0.01, 0.001, 0.0):
        both = {"gamma_delta": _DELTA * factor, "gamma_xi": _XI * factor}
        found += _both("parameters", f"Γ_δ, Γ_ξ × {factor:g}", gains=both)
    found += _both("parameters", "Γ_δ = 0", gains={"gamma_delta": 0.0})
    found += _both("parameters", "Γ_ξ = 0", gains={"gamma_xi": 0.0})
    inverse = {"gamma_delta": 1 / _DELTA, "gamma_xi": 1 / _XI}
    learn = {"gamma_f": 500.0, "gamma_g": 500.0}
    found += _both("parameters", "Γ_δ, Γ_ξ inverted", gains=inverse)
    found += _both("parameters", "Γ_f, Γ_g inverted (500)", gains=learn)
    found += _both("parameters", "all of Γ inverted", gains={**inverse, **learn})
    found += _both("parameters", "Γ_f, Γ_g × 2 (½ Γ in (15))",
                   gains={"gamma_f": 0.004, "gamma_g": 0.004})  # fmt: skip
    for value in (0.0, 0.5, 5.0, 50.0):
        found += _both("parameters", f"Γ_δo = {value:g}", gains={"gamma_delta_o": value})
    found += _both("parameters", "Γ_go = 0.002", gains={"gamma_go": 0.002})
    found += _both("parameters", "Γ_fo = 500", gains={"gamma_fo": 500.0})
    found += _both("parameters", "Γ_fo = 500, Γ_δo = 0, identifier adapts on",
                   gains={"gamma_fo": 500.0, "gamma_delta_o": 0.0}, identifier="adapt")  # fmt: skip
    for value in (20.0, 2e5):
        found += _both("parameters", f"Γ_ρ = {value:g}", gains={"gamma_rho": value})
    found += _both("parameters", "λ = k = 1", gains={"lam": 1.0, "k": 1.0})
    found += _both("parameters", "k = 100", gains={"k": 100.0})
    for b in (1.0, 3.0):
        found += _both("parameters", f"b = {b:g}", gains={"basis_width": b})
    return found


def _fault() -> list[Candidate]:
    group = "under the fault"
    found = _both(group, "δ̂, ξ̂, Ŵ held at the fault", robust="held")
    found += _both(group, "δ̂, ξ̂, Ŵ removed at the fault", robust="removed")
    for label, reading in (
        ("δ̂ held", Reading(delta="held")),
        ("ξ̂ held", Reading(xi="held")),
        ("Ŵ held", Reading(networks="held")),
        ("δ̂ removed, the others go on", Reading(delta="removed")),
        ("ξ̂ removed, the others go on", Reading(xi="removed")),
        ("δ̂, ξ̂ removed, Ŵ goes on", Reading(delta="removed", xi="removed")),
    ):
        found += _both(group, label, reading=reading)
    found += _both(group, "identifier adapts on", identifier="adapt")
    found += _both(group, "identifier adapts on, Γ_δo = 0", identifier="adapt",
                   gains={"gamma_delta_o": 0.0})  # fmt: skip
    found += _both(group, "fault of both joints", reading=Reading(both=True))
    for limit in (6.0, 20.0, 50.0):
        found += _both(group, f"|u| ≤ {limit:g} Nm", reading=Reading(limit_nm=limit))
    return found


def _equations() -> list[Candidate]:
    group = "equations"
    found = _both(group, "u as applied in (12)", reading=Reading(applied12=True))
    found += _both(group, "|e| in (13)", reading=Reading(error13=True))
    found += _both(group, "no sgn in (18)", reading=Reading(sgn18=False))
    found += _both(group, "no sgn in (18), Γ_δo = 0.5", reading=Reading(sgn18=False),
                   gains={"gamma_delta_o": 0.5})  # fmt: skip
    found += _both(group, "identifier told ρ u", reading=Reading(delivered18=True))
    found += _known(group, "g_i known")
    found.append(Candidate(2, group, "g_i known, as (M⁻¹)_ii",
                           gains={"g_min": _INVERSE[2], "g_max": _INVERSE[2]}))  # fmt: skip
    for seed in (1, 2, 3):
        found += _both(group, f"random weights, seed {seed}", reading=Reading(weights_seed=seed))
    for start in (0.5, 0.1):
        found += _both(group, f"ρ̂(0) = {start:g}", reading=Reading(rho0=start))
    found += _both(group, "q(0) = [1, 0]", reading=Reading(q0=(1.0, 0.0)))
    found.append(Candidate(2, group, "q(0) on the reference", reading=Reading(q0=(0.5, 0.3))))
    found.append(Candidate(1, group, "gain 4, 19.6 sin θ: (34) with its numbers",
                           plant="pendulums_physical"))  # fmt: skip
    found.append(Candidate(1, group, "(34) with its numbers, Γ_δ, Γ_ξ = 0, g_i known",
                           plant="pendulums_physical",
                           gains={"gamma_delta": 0.0, "gamma_xi": 0.0, "g_min": 4.0,
                                  "g_max": 4.0}))  # fmt: skip
    swapped = _motion([0.0, 1.0], [1.0, 0.0])
    found.append(Candidate(1, group, "x_11d = sin t, x_21d = 1", reading=Reading(motion=swapped)))
    sines = _motion([0.0, 0.0], [1.0, 1.0])
    found.append(Candidate(1, group, "x_11d = x_21d = sin t", reading=Reading(motion=sines)))
    return found


def _motion(offset: list[float], amplitude: list[float]) -> Any:
    """Reference offset + amplitude sin t of both joints."""
    amp = np.array(amplitude)[:, None]
    return np.array(offset), amp, np.ones((2, 1)), np.zeros((2, 1))


def _known(group: str, name: str, **changes: Any) -> list[Candidate]:
    """The same reading of both examples with ĝ_i = g_i, the networks Ŵ_g without effect."""
    gains = changes.pop("gains", {})
    return [
        Candidate(example, group, name, gains={**gains, "g_min": value, "g_max": value}, **changes)
        for example, value in _KNOWN.items()
    ]


def _combined() -> list[Candidate]:
    """Readings that leave the controller little but its networks and its feedback."""
    group = "combined"
    none = {"gamma_delta": 0.0, "gamma_xi": 0.0}
    found = _known(group, "Γ_δ, Γ_ξ = 0, g_i known", gains=none)
    for rate in (0.2, 20.0, 500.0, 1e4):
        learn = {"gamma_f": rate, "gamma_g": rate}
        name = f"Γ_δ, Γ_ξ = 0, Γ_f, Γ_g = {rate:g}"
        found += _both(group, name, gains={**none, **learn})
        found += _known(group, f"{name}, g_i known", gains={**none, **learn})
        held = Reading(networks="held")
        found += _known(group, f"{name}, g_i known, Ŵ held", gains={**none, **learn}, reading=held)
    for factor in (0.01, 0.001):
        small = {"gamma_delta": _DELTA * factor, "gamma_xi": _XI * factor}
        found += _known(group, f"Γ_δ, Γ_ξ × {factor:g}, g_i known", gains=small)
        found += _known(group, f"Γ_δ, Γ_ξ × {factor:g}, g_i known, held", gains=small,
                        robust="held")  # fmt: skip
    right = Reading(known=True)
    steady = {"gamma_go": 0.002}  # ĝ_o stays where it starts
    for factor in (1.0, 0.5):
        slow = {"lam": 5.0 * factor, "k": 10.0 * factor}
        name = "f_i, g_i, h_i known" + ("" if factor == 1.0 else f", λ, k × {factor:g}")
        found += _both(group, name, reading=right, gains=slow)
        name += ", Γ_δ, Γ_ξ = 0"
        found += _both(group, name, reading=right, gains={**none, **slow})
        found += _both(group, f"{name}, Γ_go = 0.002", reading=right,
                       gains={**none, **slow, **steady})  # fmt: skip
    for factor in (0.1, 0.001):
        small = {"gamma_delta": _DELTA * factor, "gamma_xi": _XI * factor}
        found += _both(group, f"f_i, g_i, h_i known, Γ_δ, Γ_ξ × {factor:g}", reading=right,
                       gains=small)  # fmt: skip
    found += _both(group, "f_i, g_i, h_i known, removed", reading=right, robust="removed")
    gains = {"lam": 3.5, "k": 7.0}
    name = "f_i, g_i, h_i known, removed, λ, k × 0.7"
    found += _both(group, name, reading=right, robust="removed", gains=gains)
    found += _both(group, f"{name}, Γ_go = 0.002", reading=right, robust="removed",
                   gains={**gains, **steady})  # fmt: skip
    held = Reading(networks="held")
    for factor in (0.5, 0.3):
        gains = {**none, **steady, "gamma_f": 1e4, "gamma_g": 1e4, "lam": 5.0 * factor,
                 "k": 10.0 * factor}  # fmt: skip
        name = f"Γ_δ, Γ_ξ = 0, Γ_f, Γ_g = 10000, Γ_go = 0.002, λ, k × {factor:g}, g_i known, Ŵ held"
        found += _known(group, name, gains=gains, reading=held)
    euler = Integrator("euler", 1e-3)
    found += _known(group, "Γ_δ, Γ_ξ × 0.01, g_i known, Euler 0.001 s, exact sgn",
                    gains={"gamma_delta": 5.0, "gamma_xi": 4.0}, integrator=euler,
                    epsilon=0)  # fmt: skip
    found += _known(group, "g_i known, Euler 0.001 s, exact sgn", integrator=euler, epsilon=0)
    found += _known(group, "g_i known, removed", robust="removed")
    found += _known(group, "g_i known, ε = 1 rad/s", epsilon=1.0)
    return found


def _random() -> list[Candidate]:
    """Seeded draws: adaptation gains over decades, feedback, and what acts under the fault."""
    rng = np.random.default_rng(SEED)
    found: list[Candidate] = []
    for draw in range(DRAWS):
        shrink, grow, other = rng.uniform((-5, 0, -3), (0, 6, 0))
        feedback = 10.0 ** rng.uniform(-1, 0.5)
        acts: Act = ("on", "held", "removed")[rng.integers(3)]
        known, applied = rng.random(2) < 0.5
        gains = {
            "gamma_delta": _DELTA * 10.0**shrink, "gamma_xi": _XI * 10.0**shrink,
            "gamma_f": 0.002 * 10.0**grow, "gamma_g": 0.002 * 10.0**grow,
            "gamma_delta_o": _DELTA_O * 10.0**other, "k": 10.0 * feedback,
            "lam": 5.0 * feedback,
        }  # fmt: skip
        name = (
            f"draw {draw}: Γ_δ, Γ_ξ × {10.0**shrink:.2g}, Γ_f, Γ_g × {10.0**grow:.2g}, "
            f"Γ_δo × {10.0**other:.2g}, λ, k × {feedback:.2g}, {acts}"
            + (", g_i known" if known else "")
            + (", u as applied in (12)" if applied else "")
        )
        pair = (_known if known else _both)(
            "random", name, gains=gains, robust=acts, reading=Reading(applied12=bool(applied))
        )
        found += pair
    return found
