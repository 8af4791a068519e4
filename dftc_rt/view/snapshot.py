"""One moment of a run, as the page shows it: made of records in shared memory or of a log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.control import signals
from dftc_rt.log.schema import CYCLE_HEADER, RIG_HEADER, RIG_ROWS
from dftc_rt.rt.supervisor import State

F64 = NDArray[np.float64]

_QUIET: Final = (signals.HEALTHY, signals.NOT_OBSERVABLE)


@dataclass(frozen=True)
class Snapshot:
    """One moment.

    Attributes:
        t: Run time, s.
        state: State of the run, as words.
        lateness_s: Of this cycle, s.
        overruns: So far.
        q, desired: Measured and desired position, (n,), rad (m).
        rho_hat: Estimated effectiveness, (n,); NaN where there is none.
        torque: As sent, (n,), Nm (N).
        verdict: (n,), values of :data:`dftc_rt.control.signals.VERDICTS`.
        rho: True effectiveness, (n,); None without a rig.
    """

    t: float
    state: str
    lateness_s: float
    overruns: int
    q: F64
    desired: F64
    rho_hat: F64
    torque: F64
    verdict: F64
    rho: F64 | None

    @classmethod
    def of_records(cls, cycle: F64, rig: F64 | None, n: int) -> Snapshot:
        """The moment of one record of each ring.

        Args:
            cycle: Record of ``/cycle``.
            rig: Record of ``/rig``; None when there is none yet.
            n: Number of joints.
        """
        header = dict(zip(CYCLE_HEADER, cycle.tolist(), strict=False))
        rec = cycle[len(CYCLE_HEADER) :].reshape(len(signals.NAMES), n)
        rho = None
        if rig is not None:
            rho = rig[len(RIG_HEADER) :].reshape(len(RIG_ROWS), n)[RIG_ROWS.index("rho")]
        return cls(
            t=header["t"],
            state=state_words(header["state"]),
            lateness_s=header["lateness"],
            overruns=int(header["overruns"]),
            q=rec[signals.Q],
            desired=rec[signals.QD],
            rho_hat=rec[signals.RHO_HAT],
            torque=rec[signals.TAU_CMD],
            verdict=rec[signals.VERDICT],
            rho=rho,
        )

    @property
    def error_mrad(self) -> F64:
        """Tracking error, (n,), mrad (mm)."""
        return 1e3 * (self.q - self.desired)

    def table(self, joints: tuple[str, ...]) -> str:
        """The joints as a table in Markdown."""
        lines = ["| joint | error | ρ̂ | true ρ | verdict |", "|---|--:|--:|--:|---|"]
        for i, joint in enumerate(joints):
            told = int(self.verdict[i])
            verdict = "" if told in _QUIET else signals.VERDICTS.get(told, "?")
            truth = "" if self.rho is None else f"{self.rho[i]:.2f}"
            lines.append(
                f"| {joint} | {self.error_mrad[i]:.2f} | {_share(self.rho_hat[i])} "
                f"| {truth} | {verdict} |"
            )
        return "\n".join(lines)

    def headline(self) -> str:
        """Time, state and timing in one line."""
        return (
            f"**t {self.t:.1f} s · {self.state}** · lateness {1e6 * self.lateness_s:.0f} µs"
            f" · {self.overruns} overruns"
        )


def state_words(state: float) -> str:
    """Name of a state as ``/cycle`` has it."""
    return State(int(state)).name.lower().replace("_", " ")


def _share(rho: float) -> str:
    return "–" if np.isnan(rho) else f"{rho:.2f}"
