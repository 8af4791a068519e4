"""The laws by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from dftc_rt.control import derate, plugin, settings
from dftc_rt.control.baselines.adaptive import Adaptive
from dftc_rt.control.baselines.base import AddFriction, Effectiveness, InverseDynamics, Matrices
from dftc_rt.control.baselines.computed_torque import ComputedTorque
from dftc_rt.control.baselines.eso import Eso
from dftc_rt.control.baselines.momentum import Momentum
from dftc_rt.control.baselines.oracle import Oracle
from dftc_rt.control.baselines.pd_gravity import PdGravity
from dftc_rt.control.dftc import Dftc
from dftc_rt.control.interface import F64, Law
from dftc_rt.control.layout import Joints
from dftc_rt.control.settings import Value
from dftc_rt.errors import InputError

NAMES: Final = (
    "dftc", "paper", "computed_torque", "momentum", "eso", "adaptive", "oracle", "pd_gravity",
)  # fmt: skip


def build(
    name: str,
    n: int,
    period_s: float,
    torque_limit: F64,
    torque_resolution: F64,
    delay_cycles: Any,
    gains: Mapping[str, Value],
    ftc: bool,
    q_lower: F64,
    q_upper: F64,
    velocity_limit: F64,
    inverse_dynamics: InverseDynamics | None = None,
    add_friction: AddFriction | None = None,
    matrices: Matrices | None = None,
    effectiveness: Effectiveness | None = None,
    loaded_dynamics: InverseDynamics | None = None,
) -> Law:
    """Make a law by name.

    Args:
        name: One of :data:`NAMES`, or ``module:Class`` (:mod:`dftc_rt.control.plugin`).
        n: Number of joints.
        period_s: Control period, s.
        torque_limit: Largest torque, scalar or (n,), Nm.
        torque_resolution: Step of the drives' torque, scalar or (n,), Nm; 0 for none.
        delay_cycles: Cycles from a command to the SYNC that actuates it, scalar or (n,).
        gains: Settings by name, see docs/notation.md.
        ftc: Whether the estimate acts on the command.
        q_lower: Lower position limits, (n,), rad; an infinite one is taken as -π.
        q_upper: Upper position limits, (n,), rad; an infinite one is taken as π.
        velocity_limit: (n,), rad/s; an infinite or zero one is taken as 3 rad/s.
        inverse_dynamics: (q, v, a) to torque of the whole robot, in (n,) each. Needed by
            ``computed_torque``, ``momentum`` and ``pd_gravity``; given to any law, it lowers λ
            and k at set-up to what the coupled robot holds (setting ``delay_phase``).
        add_friction: Adds the calibrated friction at a velocity to a torque; None: none is
            assumed. Laws that read ``bias`` have it there.
        matrices: M, C and G of the whole robot, for ``momentum`` and ``adaptive``.
        effectiveness: True ρ over time, for ``oracle``.
        loaded_dynamics: As ``inverse_dynamics``, with one more kilogram at the last link.

    Raises:
        InputError: The name is unknown, or a value is wrong.
        LawError: A law of one's own raised something.
    """
    if name not in NAMES and ":" not in name:
        raise InputError("control.law", repr(name), " | ".join(NAMES) + " | module:Class")
    limit = _positive("torque_limit", torque_limit, n)
    resolution = np.broadcast_to(np.asarray(torque_resolution, np.float64), (n,)).copy()
    delay = np.broadcast_to(np.asarray(delay_cycles, np.int64), (n,)).copy()
    if not (np.isfinite(resolution).all() and (resolution >= 0.0).all()):
        raise InputError("torque_resolution", str(resolution), "finite, 0 or more, Nm")
    if (delay < 0).any():
        raise InputError("delay_cycles", str(delay), "0 or more")
    if not (np.isfinite(period_s) and period_s > 0.0):
        raise InputError("period_s", repr(period_s), "a positive time in s")
    speed = np.broadcast_to(np.asarray(velocity_limit, np.float64), (n,))
    joints = Joints(
        period_s=float(period_s),
        torque_limit=limit,
        torque_resolution=resolution,
        delay_cycles=delay,
        q_lower=_finite_or(q_lower, -np.pi, n),
        q_upper=_finite_or(q_upper, np.pi, n),
        velocity_limit=np.where(np.isfinite(speed) & (speed > 0.0), speed, 3.0),
    )
    gains = dict(gains)
    if ":" in name:
        ours = {key: value for key, value in gains.items() if key in settings.NAMES}
        if inverse_dynamics is not None:
            ours.update(_held(ours, joints, inverse_dynamics))
        values = settings.parse(ours, n, printed=False).values
        gains |= {"lam": list(values["lam"]), "k": list(values["k"])}
        given = plugin.Given(joints, gains, inverse_dynamics, add_friction, matrices, ftc)
        return plugin.load(name, given)
    if name != "paper" and inverse_dynamics is not None:
        gains.update(_held(gains, joints, inverse_dynamics))
    if name in ("dftc", "paper"):
        printed = name == "paper"
        return Dftc(joints, gains, inverse_dynamics, loaded_dynamics, ftc=ftc, printed=printed)
    return _law(name, joints, gains, ftc, inverse_dynamics, add_friction, matrices, effectiveness)


def _law(
    name: str,
    joints: Joints,
    gains: Mapping[str, Value],
    ftc: bool,
    inverse_dynamics: InverseDynamics | None,
    add_friction: AddFriction | None,
    matrices: Matrices | None,
    effectiveness: Effectiveness | None,
) -> Law:
    """A baseline, once its arguments are checked."""
    if name == "eso":
        return Eso(joints, gains, add_friction, ftc=ftc)
    if name == "oracle":
        if effectiveness is None:
            raise InputError("control.law", name, "a schedule of the true effectiveness")
        return Oracle(joints, gains, effectiveness, ftc=ftc)
    if name == "adaptive":
        return Adaptive(joints, gains, _needed(name, matrices), add_friction, ftc=ftc)
    if inverse_dynamics is None:
        raise InputError("control.law", name, "a model of the whole robot")
    if name == "momentum":
        model = _needed(name, matrices)
        return Momentum(joints, gains, inverse_dynamics, model, add_friction, ftc=ftc)
    simple = PdGravity if name == "pd_gravity" else ComputedTorque
    return simple(joints, gains, inverse_dynamics, add_friction)


def _needed(name: str, matrices: Matrices | None) -> Matrices:
    """The matrices, or one line that says who has none."""
    if matrices is None:
        raise InputError("control.law", name, "a robot whose C(q, q̇) is known: no closed form")
    return matrices


def _held(
    gains: Mapping[str, Value], joints: Joints, inverse_dynamics: InverseDynamics
) -> dict[str, Value]:
    """λ and k lowered to what the coupled robot holds; the same for every law."""
    values = settings.parse(gains, joints.torque_limit.shape[0], printed=False).values
    lam, k, phase = values["lam"], values["k"], float(values["delay_phase"].min())
    if not np.isfinite(phase):
        return {}
    lag = float(values["torque_lag_s"].max())
    factor = derate.factors(inverse_dynamics, joints, lam + k, lag, phase)
    return {"lam": list(lam * factor), "k": list(k * factor)}


def _positive(where: str, values: Any, n: int) -> F64:
    """(n,) copy of finite positive values."""
    array = np.broadcast_to(np.asarray(values, np.float64), (n,)).copy()
    if not (np.isfinite(array).all() and (array > 0.0).all()):
        raise InputError(where, str(array), "finite and positive for every joint")
    return array


def _finite_or(values: Any, fallback: float, n: int) -> F64:
    """(n,) copy with the values that are not finite replaced."""
    array = np.broadcast_to(np.asarray(values, np.float64), (n,))
    return np.where(np.isfinite(array), array, fallback)
