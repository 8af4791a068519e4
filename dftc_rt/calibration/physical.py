"""Inertial parameters that some body could have: a positive definite pseudo-inertia.

Source: P. M. Wensing, S. Kim, J.-J. E. Slotine, IEEE Robotics and Automation Letters 3 (2018);
log-Cholesky parameters: C. Rucker, P. M. Wensing, IEEE Robotics and Automation Letters 7 (2022).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from dftc_rt.dynamics.regressor import pseudo_inertia

F64 = NDArray[np.float64]

_MARGIN: Final = 1e-3  # of the pseudo-inertia's trace: a smaller eigenvalue counts as none


def is_physical(parameters: F64) -> bool:
    """Whether the pseudo-inertia of 10 parameters is positive definite."""
    return bool(np.linalg.eigvalsh(pseudo_inertia(parameters))[0] > 0.0)


def nearest(x: F64, normal: F64, nominal: F64) -> F64:
    """Move a least-squares solution to the best one with physical links.

    Args:
        x: Solution; the first 10 L entries are changes of the links' parameters.
        normal: Its normal matrix.
        nominal: Nominal parameters, (L, 10).

    Returns:
        ``x`` itself when it is physical; else the minimum of the same quadratic under the
        constraint, all other entries following.
    """
    loads = nominal.size
    wanted = nominal + x[:loads].reshape(nominal.shape)
    if all(is_physical(link) for link in wanted):
        return x
    coupling = np.linalg.solve(normal[loads:, loads:], normal[loads:, :loads])
    schur = normal[:loads, :loads] - normal[:loads, loads:] @ coupling
    root = np.linalg.cholesky(0.5 * (schur + schur.T)).T

    def residual(eta: F64) -> F64:
        links = np.array([_from_log_cholesky(part) for part in eta.reshape(nominal.shape)])
        cost: F64 = root @ (links - wanted).ravel()
        return cost

    start = np.concatenate([_to_log_cholesky(_inside(link)) for link in wanted])
    eta = least_squares(residual, start).x.reshape(nominal.shape)
    links = np.array([_from_log_cholesky(part) for part in eta])
    change = (links - nominal).ravel()
    return np.concatenate([change, x[loads:] - coupling @ (change - x[:loads])])


def _inside(parameters: F64) -> F64:
    """A physical body close to ``parameters``: eigenvalues lifted to a margin."""
    values, vectors = np.linalg.eigh(pseudo_inertia(parameters))
    floor = _MARGIN * max(float(np.abs(values).sum()), 1e-6)
    return _parameters((vectors * np.maximum(values, floor)) @ vectors.T)


def _parameters(pseudo: F64) -> F64:
    """The 10 parameters of a pseudo-inertia matrix (4, 4)."""
    second, first, mass = pseudo[:3, :3], pseudo[:3, 3], pseudo[3, 3]
    inertia = np.trace(second) * np.eye(3) - second
    xx, xy, yy, xz, yz, zz = inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return np.array([mass, *first, xx, xy, yy, xz, yz, zz])


def _to_log_cholesky(parameters: F64) -> F64:
    """Unconstrained coordinates of a physical body: the Cholesky factor, its diagonal as log."""
    factor = np.linalg.cholesky(pseudo_inertia(parameters))
    lower = np.asarray(factor[np.tril_indices(4)], dtype=np.float64)
    diagonal = np.array([0, 2, 5, 9])
    lower[diagonal] = np.log(lower[diagonal])
    return lower


def _from_log_cholesky(eta: F64) -> F64:
    lower = eta.copy()
    diagonal = np.array([0, 2, 5, 9])
    lower[diagonal] = np.exp(np.clip(lower[diagonal], -30.0, 10.0))
    factor = np.zeros((4, 4))
    factor[np.tril_indices(4)] = lower
    return _parameters(factor @ factor.T)
