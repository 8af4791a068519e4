"""Which runs the summary needs, and their computation on a few cores.

A run is a :class:`Variant`: which estimate drives the gain, what becomes of δ̂, ξ̂ and of the
identifier under the fault, and ε. A loop carries along only the observers that a row needs;
each more makes it slower.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from dftc_rt.errors import InputError
from dftc_rt.paper import observers
from dftc_rt.paper.closed_loop import SAMPLE_S, Solution, solve
from dftc_rt.paper.examples import EXAMPLES
from dftc_rt.paper.fit import fit
from dftc_rt.paper.measures import Measures, measure
from dftc_rt.paper.observers import ObserverReading
from dftc_rt.paper.variant import Variant
from dftc_rt.pool import Task, available
from dftc_rt.pool import run as run_tasks

WORKERS: Final = 2
EPSILONS: Final = (0.1, 0.01, 0.001)
"""ε that every summary has a row of, rad/s."""
GAINS: Final = ("none", "true", *observers.NAMES)
"""What may drive the gain (33)."""
OURS: Final = tuple(reading.name for reading in observers.READINGS if not reading.correction)
"""Observers that are ours; the others are the paper's."""
CURVE_S: Final = 0.01
"""Spacing of the samples that are drawn, s."""


@dataclass(frozen=True)
class Drawn:
    """What the figures show.

    Attributes:
        examples: Numbers of the examples.
        epsilon: ε of tanh(s/ε), rad/s.
        gain: What drives the gain in Figs. 5 and 10: one of :data:`GAINS`.
        robust: What becomes of δ̂, ξ̂ under the fault, see :class:`Variant`.
        identifier: Whether the identifier goes on adapting under the fault.
    """

    examples: tuple[int, ...] = (1, 2)
    epsilon: float = 0.01
    gain: str = "desired"
    robust: Literal["on", "held", "removed"] = "on"
    identifier: Literal["adapt", "frozen"] = "frozen"

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            InputError: One of them is none of the choices, or ε is not positive.
        """
        for number in self.examples:
            if number not in EXAMPLES:
                raise InputError("--example", str(number), _choices(map(str, EXAMPLES)))
        if not 1e-4 <= self.epsilon <= 1.0:  # below, the solver stands still at every crossing
            raise InputError("--epsilon", f"{self.epsilon:g}", "a number from 0.0001 to 1")
        for flag, value, choices in (
            ("--gain", self.gain, GAINS),
            ("--robust", self.robust, ("on", "held", "removed")),
            ("--identifier", self.identifier, ("adapt", "frozen")),
        ):
            if value not in choices:
                raise InputError(flag, f"'{value}'", _choices(choices))

    def faulty(self, example: int, gain: str) -> Variant:
        """The variant under the fault that is drawn, with the gain driven by ``gain``."""
        return Variant(
            example, self.epsilon, gain=gain, robust=self.robust, identifier=self.identifier
        )

    @property
    def usual(self) -> bool:
        """Whether the figures show what they show by default."""
        return dataclasses.replace(self, examples=(1, 2)) == Drawn()


def _choices(names: Iterable[str]) -> str:
    return "one of " + ", ".join(names)


def slug(variant: Variant) -> str:
    """Name of a variant in tables and files: ``example1 gain-desired eps0.01``."""
    parts = [f"example{variant.example}"]
    if not variant.fault:
        parts.append("fault-free")
    parts.append("no-gain" if variant.gain == "none" else f"gain-{variant.gain}")
    if variant.robust != "on":
        parts.append(variant.robust)
    if variant.identifier == "adapt":
        parts.append("adapting")
    return " ".join([*parts, f"eps{variant.epsilon:g}"])


def fault_free(example: int, epsilon: float) -> Variant:
    """The healthy system; its identifier is being trained."""
    return Variant(example, epsilon, fault=False, identifier="adapt")


def carried(variant: Variant, epsilon: float) -> tuple[ObserverReading, ...]:
    """The observers that run along in a variant's loop.

    Args:
        variant: The variant.
        epsilon: ε of the figures; loops at another one carry less, as fewer rows need them.
    """
    own = variant.gain
    if own == "true_rho":
        names: tuple[str, ...] = ("true_rho", "measured")
    elif own in OURS and variant.epsilon == epsilon:
        names = OURS
    else:
        names = (own,)
    return tuple(reading for reading in observers.READINGS if reading.name in names)


def standard(example: int, epsilon: float) -> list[Variant]:
    """Variants that every summary has rows of."""
    variants = [
        fault_free(example, epsilon),
        Variant(example, epsilon, fault=False, robust="held"),
        Variant(example, epsilon, fault=False, robust="removed"),
        Variant(example, epsilon),
        Variant(example, epsilon, identifier="adapt"),
        Variant(example, epsilon, robust="held"),
        Variant(example, epsilon, robust="removed"),
        Variant(example, epsilon, gain="desired"),
        Variant(example, epsilon, gain="measured"),
        Variant(example, epsilon, gain="true_rho"),
        Variant(example, epsilon, gain="true_rho", identifier="adapt"),
        Variant(example, epsilon, gain="true_rho", robust="held"),
        Variant(example, epsilon, gain="true_rho", robust="removed"),
    ]
    for other in EPSILONS:
        if other != epsilon:
            variants += [
                Variant(example, other, gain=gain) for gain in ("none", "desired", "true_rho")
            ]
    return variants


def shown(drawn: Drawn, example: int) -> list[Variant]:
    """Variants of which curves are drawn, each once."""
    variants = [
        fault_free(example, drawn.epsilon),
        drawn.faulty(example, "none"),
        drawn.faulty(example, drawn.gain),
        *(drawn.faulty(example, gain) for gain in ("desired", "measured", "true_rho")),
    ]
    return list({slug(variant): variant for variant in variants}.values())


def loop_of(observer: str, drawn: Drawn) -> str:
    """What drives the gain of the loop in which an observer is read.

    The paper's are read in the loops whose gain they drive, ours in that of Fig. 5 or 10 if
    its gain is one of them, else in that of ``desired``.
    """
    if observer not in OURS:
        return observer
    return drawn.gain if drawn.gain in OURS else "desired"


@dataclass(frozen=True)
class Results:
    """What came out.

    Attributes:
        measures: By :func:`slug`.
        curves: Solutions thinned to :data:`CURVE_S`, of the variants that are drawn.
        extra: Results of further tasks, by name.
    """

    measures: Mapping[str, Measures]
    curves: Mapping[str, Solution]
    extra: Mapping[str, Any]


def compute(
    drawn: Drawn,
    extra: Sequence[Task] = (),
    progress: Callable[[str, int, int], None] = lambda name, done, total: None,
) -> Results:
    """Simulate everything that the figures and the summary need.

    Args:
        drawn: What the figures show.
        extra: Further tasks for the same workers.
        progress: Told a name, and how many runs of how many are done.

    Raises:
        EnvironmentLacksError: A worker was killed.
    """
    tasks: list[Task] = []
    for lane, example in enumerate(drawn.examples):
        visible = {slug(v): v for v in shown(drawn, example)}
        wanted = {slug(v): v for v in standard(example, drawn.epsilon)} | visible
        for name, variant in wanted.items():
            arguments = (variant, carried(variant, drawn.epsilon), name in visible)
            tasks.append(Task(name, simulate, arguments, lane))
    tasks += extra
    count = 0

    def done(task: Task) -> None:
        nonlocal count
        count += 1
        progress(task.name, count, len(tasks))

    found = run_tasks(tasks, min(WORKERS, available()), done)
    further = {task.name: found.pop(task.name) for task in extra}
    return Results(
        {name: measures for name, (measures, _) in found.items()},
        {name: curves for name, (_, curves) in found.items() if curves is not None},
        further,
    )


def simulate(
    variant: Variant, readings: Sequence[ObserverReading], curves: bool
) -> tuple[Measures, Solution | None]:
    """Simulate and measure a variant; runs in a worker.

    Args:
        variant: What; with networks of the observer ``fitted`` from rich data.
        readings: Observers that run along.
        curves: Whether the solution is returned too, thinned.
    """
    fitted = dataclasses.replace(variant, fitted=_fitted(variant.example))
    solution = solve(fitted, readings=readings)
    return measure(solution), thin(solution) if curves else None


_fitted = functools.cache(fit)


def thin(solution: Solution) -> Solution:
    """Every tenth sample or so: spacing :data:`CURVE_S`."""
    every = slice(None, None, round(CURVE_S / SAMPLE_S))
    return dataclasses.replace(
        solution,
        t=solution.t[every],
        q=solution.q[every],
        v=solution.v[every],
        signals=solution.signals[every],
        rho_hat=solution.rho_hat[every],
        rho=solution.rho[every],
    )
