"""Laws of one's own, named ``module:Class`` in a scenario or on the command line."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from dftc_rt.control.baselines.base import AddFriction, InverseDynamics, Matrices
from dftc_rt.control.interface import F64, NONFINITE_INPUT, NONFINITE_LAW
from dftc_rt.control.layout import Joints
from dftc_rt.control.settings import Value
from dftc_rt.control.signals import (
    AD,
    NOT_OBSERVABLE,
    OBSERVABLE,
    QD,
    RESIDUAL,
    RHO_HAT,
    RHO_STD,
    TAU_CMD,
    TAU_LAW,
    VD,
    VERDICT,
    Q,
    S,
    V,
)
from dftc_rt.errors import InputError, LawError

_EXPECTED: Final = "module:Class, importable or in the current folder"


@dataclass(frozen=True)
class Given:
    """What a law is made from.

    Attributes:
        joints: Period in s, torque limits in Nm, delays and position limits, each (n,).
        gains: ``lam`` and ``k`` as every law gets them, and ``[control.gains]`` over those of the
            robot and the calibration, with whatever keys the law itself has; numbers, or n of them.
        inverse_dynamics: (q, v, a) to torque of the whole robot, (n,) each.
        add_friction: (torque, v): adds the calibrated friction; None: none is known.
        matrices: M, C and G of the whole robot; None for a plant in closed form.
        ftc: ``control.ftc``.
    """

    joints: Joints
    gains: Mapping[str, Value]
    inverse_dynamics: InverseDynamics | None
    add_friction: AddFriction | None
    matrices: Matrices | None
    ftc: bool

    def gain(self, name: str, default: float) -> F64:
        """Return a gain as one number for each joint, (n,).

        Raises:
            InputError: It is not a finite number, nor n of them.
        """
        n = self.joints.torque_limit.shape[0]
        value = self.gains.get(name, default)
        try:
            numbers = np.broadcast_to(np.asarray(value, dtype=np.float64), (n,)).copy()
        except (ValueError, TypeError):
            numbers = np.full(n, np.nan)
        if not np.isfinite(numbers).all():
            raise InputError(f"control.gains.{name}", repr(value), f"a finite number, or {n}")
        return numbers


class TorqueLaw:
    """Base of a law that is a torque for each joint: derive from it and write :meth:`torque`.

    The torque is held to the limit of the drive and rounded to its resolution; whatever is raised
    or not finite ends the run in order. Nothing says that the joints are kept apart: a law is
    decentralised if its torque of joint i depends on row i of the measurements alone.

    Attributes:
        given: What the law is made from.
    """

    uses_local_terms = False
    """Set to True to find ``inertia`` and ``bias`` of this cycle in the attributes of that name."""

    def __init__(self, given: Given) -> None:
        """Keep ``given``.

        Raises:
            InputError: Whatever the law finds wrong with its gains.
        """
        self.given = given
        self.ftc = False
        n = given.joints.torque_limit.shape[0]
        self.inertia = np.zeros(n)
        self.bias = np.zeros(n)

    def start(self, q: F64, v: F64) -> None:
        """Forget everything; at rest at q (n,), rad, v (n,), rad/s, before the first cycle."""

    def skip(self, ticks: int) -> None:
        """``ticks`` periods passed without a cycle: the machine was too slow."""

    def told(self, joint: int, tau: float) -> None:
        """Of a replay: the last command of a joint was tau, Nm, and not what was returned."""

    def torque(self, q: F64, v: F64, qd: F64, vd: F64, ad: F64) -> F64:
        """Return this cycle's torques.

        Args:
            q: Measured positions, (n,), rad.
            v: Measured velocities, (n,), rad/s.
            qd: Desired positions, (n,), rad.
            vd: Desired velocities, (n,), rad/s.
            ad: Desired accelerations, (n,), rad/s².

        Returns:
            (n,), Nm.
        """
        raise NotImplementedError

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """One cycle, see :class:`dftc_rt.control.interface.Law`. May write ρ̂ and verdicts too."""
        self.inertia[:] = inertia
        self.bias[:] = bias
        rec[TAU_LAW] = self.torque(rec[Q], rec[V], rec[QD], rec[VD], rec[AD])
        rec[TAU_CMD] = rec[TAU_LAW]
        return 0


class Guarded:
    """A law of one's own, kept from sending what no drive should get.

    Attributes:
        ftc: As the law says.
        uses_local_terms: As the law says.
    """

    def __init__(self, name: str, law: Any, given: Given) -> None:
        joints = given.joints
        self._name = name
        self._law = law
        self._lam = given.gain("lam", 1.0)
        self._limit = joints.torque_limit
        stepped = joints.torque_resolution > 0.0
        self._step = np.where(stepped, joints.torque_resolution, 1.0)
        self._counts = np.where(stepped, np.floor(joints.torque_limit / self._step + 1e-9), np.inf)
        self._stepped = stepped
        self.ftc = bool(law.ftc)
        self.uses_local_terms = bool(law.uses_local_terms)

    def start(self, q: F64, v: F64) -> None:
        """See :class:`dftc_rt.control.interface.Law`."""
        for name, values in (("q", q), ("v", v)):
            if np.shape(values) != self._limit.shape or not np.isfinite(values).all():
                raise InputError(
                    f"start {name}", str(values), f"{self._limit.shape[0]} finite values"
                )
        try:
            self._law.start(q.copy(), v.copy())
        except InputError:  # a wrong gain is the user's, and says where
            raise
        except Exception as error:
            raise LawError(self._name, error) from error

    def skip(self, ticks: int) -> None:
        """See :class:`dftc_rt.control.interface.Law`."""
        try:
            self._law.skip(ticks)
        except InputError:  # a wrong gain is the user's, and says where
            raise
        except Exception as error:
            raise LawError(self._name, error) from error

    def told(self, joint: int, tau: float) -> None:
        """See :class:`dftc_rt.control.interface.Law`."""
        try:
            self._law.told(joint, tau)
        except InputError:
            raise
        except Exception as error:
            raise LawError(self._name, error) from error

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """See :class:`dftc_rt.control.interface.Law`; the command is clipped and rounded.

        Raises:
            LawError: The law raised something.
        """
        rec[RHO_HAT] = rec[RHO_STD] = rec[RESIDUAL] = math.nan
        rec[OBSERVABLE] = 0.0
        rec[VERDICT] = NOT_OBSERVABLE
        rec[TAU_LAW] = rec[TAU_CMD] = 0.0
        if not np.isfinite(rec[: AD + 1]).all():
            rec[S] = math.nan
            return NONFINITE_INPUT
        measured = rec[: AD + 1].copy()
        rec[S] = self._lam * (rec[Q] - rec[QD]) + rec[V] - rec[VD]
        try:
            status = int(self._law.update(rec, inertia, bias, load))
        except InputError:  # a wrong gain is the user's, and says where
            raise
        except Exception as error:
            raise LawError(self._name, error) from error
        rec[: AD + 1] = measured  # what was measured and wanted is not the law's to say
        if not np.isfinite(rec[TAU_CMD]).all():
            rec[S] = np.where(np.isfinite(rec[TAU_CMD]), rec[S], math.nan)
            rec[TAU_LAW] = rec[TAU_CMD] = 0.0
            return status | NONFINITE_LAW
        steps = np.clip(rec[TAU_CMD] / self._step, -self._counts, self._counts)
        told = np.where(self._stepped, np.floor(steps + 0.5) * self._step, rec[TAU_CMD])
        rec[TAU_CMD] = np.clip(told, -self._limit, self._limit)
        return status


def load(name: str, given: Given) -> Guarded:
    """Import a law and make it.

    Args:
        name: ``module:Class``; the class is derived from :class:`TorqueLaw`, or has the methods
            of :class:`dftc_rt.control.interface.Law`, and is made with one argument.
        given: That argument.

    Raises:
        InputError: There is no such module or class, it is no law, or it refuses its gains.
        LawError: Importing or making it raised something else.
    """
    module_name, _, class_name = name.partition(":")
    here = str(Path.cwd())
    sys.path.append(here)  # last: a file here never hides an installed package
    try:
        found = getattr(importlib.import_module(module_name), class_name, None)
    except ModuleNotFoundError as error:
        if error.name is not None and (module_name + ".").startswith(error.name + "."):
            raise InputError("control.law", f"no module {module_name!r}", _EXPECTED) from error
        raise LawError(name, error) from error
    except Exception as error:
        raise LawError(name, error) from error
    finally:
        sys.path.remove(here)
    if not isinstance(found, type):
        raise InputError("control.law", f"{module_name!r} has no class {class_name!r}", _EXPECTED)
    try:
        law = found(given)
    except InputError:
        raise
    except Exception as error:
        raise LawError(name, error) from error
    missing = [
        what
        for what in ("start", "skip", "told", "update", "ftc", "uses_local_terms")
        if not hasattr(law, what)
    ]
    if missing:
        raise InputError("control.law", f"{name} has no {missing[0]!r}", "what TorqueLaw has")
    return Guarded(name, law, given)
