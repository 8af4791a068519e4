"""Alarms of the law ``momentum`` at every threshold, from runs without one."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dftc_rt.benchmark import negative, sweep
from dftc_rt.benchmark.cases import Group
from dftc_rt.benchmark.negative import Item, item_settings
from dftc_rt.benchmark.rows import SweepRow
from dftc_rt.cli.benchmark_runs import base_settings, fitting, names, opened_session
from dftc_rt.cli.session import Session
from dftc_rt.control.baselines.momentum import Momentum
from dftc_rt.control.interface import Law
from dftc_rt.control.signals import OBSERVABLE

F64 = NDArray[np.float64]


def sweep_rows(
    group: Group, calibration: str, fingerprint: str, extra: Sequence[str], item: Item
) -> Iterator[SweepRow]:
    """Run an item of the negative set with ``momentum``, and count its alarms at all thresholds.

    Args:
        group: Which, with the factor :data:`dftc_rt.benchmark.sweep.NO_THRESHOLD`.
        calibration: File.
        fingerprint: Of the row.
        extra: Further overrides of the scenario.
        item: The item.
    """
    known, base = base_settings(group, calibration, extra)
    robot = opened_session(group.robot, [*base, "fault=[]"]).robot
    found = item_settings(item, group.seed, robot.home, robot.lower, robot.upper)
    watched: list[Watched] = []

    def watch(opened: Session) -> Session:
        watched.append(Watched(opened.parts.law))
        return dataclasses.replace(opened, parts=dataclasses.replace(opened.parts, law=watched[-1]))

    done, _ = fitting(group.robot, [*base, *found], watch)
    calibrated = np.array([joint.gains["threshold_loss"] for joint in known.joint])
    counts = watched[-1].alarms(calibrated, 1.0 / done.opened.scenario.executor.rate_hz)
    yield SweepRow(
        id=negative.item_id(group, item.name),
        item=item.name,
        counts=" ".join(str(count) for count in counts),
        **names(group, fingerprint),
        **done.facts,
    )


class Watched:
    """The law ``momentum``, and what its CUSUM of a loss did.

    Attributes:
        ftc: As of the law.
        uses_local_terms: As of the law.
    """

    def __init__(self, law: Law) -> None:
        """Watch a law."""
        assert isinstance(law, Momentum)
        self._law = law
        self.ftc = law.ftc
        self.uses_local_terms = law.uses_local_terms
        self._seen: list[tuple[F64, F64, F64]] = []

    def start(self, q: F64, v: F64) -> None:
        """Reset the law, and forget."""
        self._seen.clear()
        self._law.start(q, v)

    def skip(self, ticks: int) -> None:
        """Ticks without a cycle."""
        self._law.skip(ticks)

    def told(self, joint: int, tau: float) -> None:
        """Another command was sent."""
        self._law.told(joint, tau)

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """One cycle."""
        status = self._law.update(rec, inertia, bias, load)
        state = self._law.state
        self._seen.append((state["loss"].copy(), state["rho"].copy(), rec[OBSERVABLE].copy()))
        return status

    def alarms(self, threshold_loss: F64, period_s: float) -> list[int]:
        """Alarms at each of :data:`dftc_rt.benchmark.sweep.FACTORS` times a threshold (n,)."""
        p = self._law.parameters
        decision = sweep.Decision(
            threshold_loss, p["threshold_anomaly"], p["rho_loss"], p["rho_clear"], p["clear_s"],
            period_s,
        )  # fmt: skip
        loss, rho, observable = (np.array(each) for each in zip(*self._seen, strict=True))
        return [int(count) for count in sweep.alarms(loss, rho, observable == 1.0, decision)]
