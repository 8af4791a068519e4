"""The estimator over a log: what it makes of recorded feedback and recorded commands.

The law itself runs, with the same kernel as in the loop; only its own commands are replaced
by those that were sent, since it is them that the drives obeyed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dftc_rt.control import signals
from dftc_rt.control.dftc import Dftc
from dftc_rt.dynamics.interface import JointTerms

F64 = NDArray[np.float64]
Signals = dict[str, F64]


@dataclass(frozen=True)
class Replayed:
    """What the estimator saw, K cycles of n joints.

    Attributes:
        inertia: M_i, (K, n), kg m².
        bias: (K, n), Nm.
        state: Fields of :data:`dftc_rt.control.layout.STATE` by name, (K, n) each.
        verdict: (K, n).
    """

    inertia: F64
    bias: F64
    state: dict[str, F64]
    verdict: F64


def replay(law: Dftc, terms: JointTerms, log: Signals, fields: Sequence[str]) -> Replayed:
    """Feed a log to a law.

    Args:
        law: The law; it is started anew.
        terms: Local terms of the robot as it is believed to be.
        log: Rows of ``/cycle`` by name, (K, n) each.
        fields: State to keep.
    """
    rows = {index: log[name] for index, name in enumerate(signals.NAMES) if name in log}
    cycles, n = log["q"].shape
    rec = np.zeros((len(signals.NAMES), n))
    inputs = [signals.Q, signals.V, signals.QD, signals.VD, signals.AD, signals.AGE]
    kept = {name: np.empty((cycles, n)) for name in fields}
    inertia, bias, verdict = np.empty((3, cycles, n))
    storage = law.storage
    depth = storage.history.shape[1]
    q, v, qd, vd, ad = rec[: signals.AD + 1]
    law.start(log["q"][0], log["v"][0])
    for k in range(cycles):
        for row in inputs:
            rec[row] = rows[row][k]
        terms.update(q, v, qd, vd, ad)
        law.update(rec, terms.inertia, terms.bias, terms.load)
        storage.history[:, k % depth] = log["tau_cmd"][k]
        inertia[k], bias[k], verdict[k] = terms.inertia, terms.bias, rec[signals.VERDICT]
        for name, values in kept.items():
            values[k] = storage.state[name]
    return Replayed(inertia, bias, kept, verdict)
