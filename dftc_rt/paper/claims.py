"""What the ten figures claim, and how each claim is measured here.

Everything that is judged is a method of :class:`Judge`, which picks the runs and the number;
the rules' bounds and what follows from them are in :mod:`dftc_rt.paper.verdicts`.

Source: [zhao2017] section 5.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from dftc_rt.paper import observers
from dftc_rt.paper.examples import Example
from dftc_rt.paper.measures import START_S, Measures
from dftc_rt.paper.runs import EPSILONS, OURS, Drawn, fault_free, loop_of, slug
from dftc_rt.paper.variant import Variant
from dftc_rt.paper.verdicts import (
    FOLLOWS,
    IDENTIFIED,
    LOST_FACTOR,
    TARGETS,
    TRACKS_MRAD,
    Finding,
    Row,
    Sampled,
    Target,
    known,
    per_joint,
)

_TOLD: Final = "the true ρ in (27), which a robot does not have"
_WORDS: Final = {reading.name: reading.title for reading in observers.READINGS}
_PAPERS: Final = ("measured", "true_rho")
_AS_DRAWN: Final = "as drawn"
_AT_1_KHZ: Final = "ours: law `dftc` at 1 kHz with encoder and velocity noise"


class Judge:
    """Findings of one example."""

    def __init__(
        self,
        example: Example,
        measures: Mapping[str, Measures],
        drawn: Drawn,
        sampled: Sampled | None = None,
    ) -> None:
        """Take what was measured.

        Args:
            example: The example.
            measures: By :func:`dftc_rt.paper.runs.slug`: the standard variants and what is
                drawn.
            drawn: What the figures show.
            sampled: The run at 1 kHz, if there was one.
        """
        self._example = example
        self._measures = measures
        self._drawn = drawn
        self._epsilon = drawn.epsilon
        self._sampled = sampled
        self._others = [e for e in EPSILONS if e != drawn.epsilon]
        self._first = 1 if example.number == 1 else 6

    def findings(self) -> list[Finding]:
        """The example's five figures, in order."""
        return [
            self._tracking(),
            self._without_gain(),
            self._identification(),
            self._effectiveness(),
            self._with_gain(),
        ]

    def targets(self) -> list[Target]:
        """What our observer is to reach."""
        ours = self._of(gain="desired").rho_rmse
        n = self._example.number
        noisy = None if self._sampled is None else known(self._sampled.rho_rmse)
        return [
            Target(n, "noise-free, split", known(ours["desired"]), TARGETS["desired"]),
            Target(n, "noise-free, RBF fit", known(ours["fitted"]), TARGETS["fitted"]),
            Target(n, "1 kHz with noise, split", noisy, TARGETS["noise"]),
        ]

    def _of(self, epsilon: float | None = None, **like: Any) -> Measures:
        """Measures of a variant of this example, given by the fields of :class:`Variant`."""
        e = self._epsilon if epsilon is None else epsilon
        return self._measures[slug(Variant(self._example.number, e, **like))]

    def _as_drawn(self, gain: str) -> Measures:
        return self._measures[slug(self._drawn.faulty(self._example.number, gain))]

    def _healthy(self) -> Measures:
        return self._measures[slug(fault_free(self._example.number, self._epsilon))]

    # --- Figures 1 and 6

    def _tracking(self) -> Finding:
        def row(title: str, m: Measures, *conditions: str) -> Row:
            number = max(m.healthy_largest) * 1e3
            return Row(
                title, known(number), number <= TRACKS_MRAD, True, conditions,
                per_joint("RMS", m.healthy_rms),
            )  # fmt: skip

        rows = [row(f"ε = {self._epsilon:g}", self._healthy())]
        rows += [
            row(f"ε = {e:g}, until the fault", self._of(e), f"ε = {e:g}") for e in self._others
        ]
        claim = "both joints track their references"
        if self._first == 6:
            claim = "both joints track, settled within 1 s"
        return Finding(
            self._first, self._example.number, "Tracking without a fault", claim,
            f"largest |e_i1| of both joints from {START_S:g} s on", "mrad",
            f"at most {TRACKS_MRAD:g} mrad", rows,
        )  # fmt: skip

    # --- Figures 2 and 7

    def _without_gain(self) -> Finding:
        def row(title: str, m: Measures, twin: float, *conditions: str) -> Row:
            number = m.faulty_rms[0] * 1e3
            met = number > TRACKS_MRAD and number >= LOST_FACTOR * twin * 1e3
            detail = {"without the fault/mrad": known(twin * 1e3)}
            return Row(title, known(number), met, True, conditions, detail)

        rows = [row("δ̂, ξ̂ go on adapting", self._of(), self._healthy().faulty_rms[0])]
        for robust, words in (("held", "held from the fault on"), ("removed", "removed")):
            twin = self._of(fault=False, robust=robust).faulty_rms[0]
            what = f"δ̂, ξ̂ {words}"
            rows.append(row(what, self._of(robust=robust), twin, what))
        lost_anyway = twin * 1e3 > TRACKS_MRAD
        for e in self._others:
            m = self._of(e)  # there is no run without the fault at this ε
            what = f"ε = {e:g}, against before the fault"
            rows.append(row(what, m, m.healthy_rms[0], f"ε = {e:g}"))
        if not self._drawn.usual:
            m = self._as_drawn("none")
            rows.append(replace(row(_AS_DRAWN, m, m.healthy_rms[0]), printed=False))
        remark = ""
        if not any(row.met for row in rows):
            remark = "δ̂ and ξ̂ hide the fault."
            if lost_anyway:
                remark += " Without them tracking is lost, and without the fault as well."
        return Finding(
            self._first + 1, self._example.number, "Tracking under the fault, without the gain",
            "joint 1 cannot follow its reference", "RMS of e_11 under the fault", "mrad",
            f"more than {TRACKS_MRAD:g} mrad, and {LOST_FACTOR:g} times that of the same law "
            "without the fault", rows, remark,
        )  # fmt: skip

    # --- Figures 3 and 8

    def _identification(self) -> Finding:
        def row(title: str, m: Measures, *conditions: str) -> Row:
            number = m.identification_velocity
            met = number <= IDENTIFIED and m.identification_position <= IDENTIFIED
            detail = {"|e_i1o|/rad": known(m.identification_position)}
            return Row(title, known(number), met, True, conditions, detail)

        at = f"{self._example.fault_s:g} s"
        rows = [
            row("no fault, identifier adapting", self._healthy()),
            row(
                f"no fault, identifier frozen from {at} on, δ̂, ξ̂ held",
                self._of(fault=False, robust="held"), "identifier frozen",
            ),
            row(
                f"fault at {at}, no gain, identifier adapting", self._of(identifier="adapt"),
                "under the fault",
            ),
            row(
                f"fault at {at}, no gain, identifier frozen from there on", self._of(),
                "under the fault", "identifier frozen",
            ),
        ]  # fmt: skip
        return Finding(
            self._first + 2, self._example.number, "Identification error",
            "the identifier's errors vanish",
            f"largest |e_i2o| of both joints from {START_S:g} s on", "rad/s",
            f"at most {IDENTIFIED:g} rad/s, and |e_i1o| at most {IDENTIFIED:g} rad", rows,
        )  # fmt: skip

    # --- Figures 4 and 9

    def _effectiveness(self) -> Finding:
        def row(name: str, m: Measures, what: str = "", *conditions: str) -> Row:
            number = m.rho_rmse[name]
            told = (_TOLD,) if name == "true_rho" else ()
            return Row(
                _WORDS[name] + (f", {what}" if what else ""), known(number), number <= FOLLOWS,
                name not in OURS, (*told, *conditions),
            )  # fmt: skip

        rows = [row(name, self._of(gain=name)) for name in _PAPERS]
        for what, m in (
            ("identifier adapting", self._of(gain="true_rho", identifier="adapt")),
            ("δ̂, ξ̂ held", self._of(gain="true_rho", robust="held")),
            ("δ̂, ξ̂ removed", self._of(gain="true_rho", robust="removed")),
            *((f"ε = {e:g}", self._of(e, gain="true_rho")) for e in self._others),
        ):
            rows += [row(name, m, what, what) for name in _PAPERS]
        rows += [row(name, self._of(gain="desired")) for name in OURS]
        rows += [row("desired", self._of(e, gain="desired"), f"ε = {e:g}") for e in self._others]
        if self._sampled is not None:
            number = self._sampled.rho_rmse
            rows.append(Row(_AT_1_KHZ, known(number), number <= FOLLOWS, printed=False))
        if not self._drawn.usual:
            for name in observers.NAMES:
                drawn = row(name, self._as_drawn(loop_of(name, self._drawn)), _AS_DRAWN)
                rows.append(replace(drawn, printed=False))
        remark = ""
        if rows[_PAPERS.index("true_rho")].met:
            remark = "With the true ρ in (27), ρ̂ is fitted to what was made with ρ."
        elif self._example.number == 1:
            remark = (
                "Joint 1 stands still, so that g_1 is not identifiable: not even the true ρ helps."
            )
        after = self._example.settle_s
        return Finding(
            self._first + 3, self._example.number, "Effectiveness and its estimate",
            "ρ̂_1 follows ρ_1", f"RMSE of ρ̂_1 from {after:g} s after the fault on", "",
            f"at most {FOLLOWS:g}", rows, remark,
        )  # fmt: skip

    # --- Figures 5 and 10

    def _with_gain(self) -> Finding:
        def row(title: str, m: Measures, printed: bool, *conditions: str) -> Row:
            number = max(m.faulty_largest) * 1e3
            return Row(
                title, known(number), number <= TRACKS_MRAD, printed, conditions,
                per_joint("RMS", m.faulty_rms),
            )  # fmt: skip

        rows = []
        for name in _PAPERS:
            told = (_TOLD,) if name == "true_rho" else ()
            rows.append(row(f"gain from {_WORDS[name]}", self._of(gain=name), True, *told))
        adapting = self._of(gain="true_rho", identifier="adapt")
        what = "identifier adapting"
        rows.append(row(f"gain from {_WORDS['true_rho']}, {what}", adapting, True, _TOLD, what))
        for robust, what in (("held", "δ̂, ξ̂ held"), ("removed", "δ̂, ξ̂ removed (Remark 6)")):
            title = f"gain from {_WORDS['true_rho']}, {what}"
            rows.append(row(title, self._of(gain="true_rho", robust=robust), True, _TOLD, what))
        for e in self._others:
            told_e = (f"ε = {e:g}", _TOLD)
            title = f"gain from {_WORDS['true_rho']}, ε = {e:g}"
            rows.append(row(title, self._of(e, gain="true_rho"), True, *told_e))
        for e in (self._epsilon, *self._others):
            title = f"{_WORDS['desired']}, ε = {e:g}"
            rows.append(row(title, self._of(e, gain="desired"), False))
        if self._sampled is not None:
            largest = max(self._sampled.largest_mrad)
            detail = per_joint("RMS", [rms * 1e-3 for rms in self._sampled.rms_mrad])
            rows.append(Row(_AT_1_KHZ, known(largest), largest <= TRACKS_MRAD, False, (), detail))
        if not self._drawn.usual:
            rows.append(row(_AS_DRAWN, self._as_drawn(self._drawn.gain), False))
        without = row("for comparison: no gain", self._of(), False)
        rows.append(without)
        remark = ""
        if without.met:
            remark = (
                "So does the law without the gain: the figure does not show what the gain does."
            )
        return Finding(
            self._first + 4, self._example.number, "Tracking under the fault, with the gain",
            "both joints track under the fault",
            f"largest |e_i1| of both joints from {self._example.settle_s:g} s after the fault on",
            "mrad", f"at most {TRACKS_MRAD:g} mrad", rows, remark,
        )  # fmt: skip
