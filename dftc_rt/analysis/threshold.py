"""How large a residual has to be to speak for a fault, as the law of a log judged it.

The test of ρ = 1 ∓ Δ against ρ = 1 (:mod:`dftc_rt.control.decision`) weighs y = φ + e, with φ
the torque of a healthy drive. Evidence for a loss grows exactly while (y - φ)² > (y - (1 - Δ) φ)²,
that is, while the residual e is beyond Δ/2 · |φ| on the side that φ is not on; on the other side
it is evidence for ρ above 1. It has to last, until the sum passes its own threshold.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.analysis.faults import scenario_of
from dftc_rt.analysis.timing import period_s
from dftc_rt.control import settings
from dftc_rt.control.observer import PRINTED
from dftc_rt.errors import DftcError
from dftc_rt.log.run import Run

F64 = NDArray[np.float64]

_FILTERS: Final = {"dftc": "bandwidth", "momentum": "momentum_bandwidth"}
"""Law that tests its residual -> setting of the filter of φ, rad/s."""


def residual_threshold(run: Run) -> F64 | None:
    """Δ/2 · |φ|, shape ``(K, n)``, Nm; NaN where φ is too small for ρ to be observed.

    Args:
        run: The run.

    Returns:
        None for a law that does not test its residual so, or a log that does not say which.
    """
    control = scenario_of(run).get("control", {})
    filtered = _FILTERS.get(control.get("law", ""))
    if filtered is None or len(run.cycle["t"]) < 2:
        return None
    try:
        values = settings.parse(_gains(run, control), len(run.joints), printed=False).values
    except (DftcError, ValueError, TypeError, KeyError, AttributeError):
        return None  # of another version: what is drawn would be a guess
    if (values["observer"] == PRINTED).any():
        return None
    limit = np.zeros(len(run.joints)) if run.torque_limit is None else np.array(run.torque_limit)
    least = values["excitation"] * (values["floor_nm"] + values["floor_fraction"] * limit)
    phi = np.abs(_healthy_torque(run, values[filtered]))
    return np.where(phi < least, np.nan, 0.5 * values["rho_step"] * phi)


def _healthy_torque(run: Run, bandwidth: F64) -> F64:
    """φ: the torque sent, a cycle later, through the filter of the residual, ``(K, n)``, Nm."""
    from scipy.signal import lfilter

    sent = np.nan_to_num(run.cycle["tau_cmd"])
    acting = np.vstack([sent[:1], sent[:-1]])
    shares = -np.expm1(-bandwidth * period_s(run.cycle["t"]))
    phi = np.empty_like(sent)
    for i, share in enumerate(shares.tolist()):
        phi[:, i] = lfilter([share], [1.0, share - 1.0], acting[:, i])
    return phi


def _gains(run: Run, control: Mapping[str, Any]) -> dict[str, Any]:
    """Settings by name: the robot's, the calibration's, and the scenario's, which win."""
    files = {name: tomllib.loads(data.decode()) for name, data in run.attachments.items()
             if name in ("robot.toml", "calibration.toml")}  # fmt: skip
    found: dict[str, Any] = dict(files.get("robot.toml", {}).get("gains", {}))
    joints = files.get("calibration.toml", {}).get("joint", ())
    for key in joints[0].get("gains", {}) if joints else ():
        found[key] = [joint["gains"][key] for joint in joints]
    found |= control.get("gains", {})
    return {key: value for key, value in found.items() if key in settings.NAMES}
