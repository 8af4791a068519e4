"""Decision stage of one joint: is the actuator healthy, and may the gain act?

Two CUSUM sums of the log-likelihood ratio of ρ = 1 ∓ Δ against ρ = 1 on y = ρ φ, with the
variance inflated for coloured noise: the first to grow makes an anomaly, one that has gathered
enough information, with ρ̂ agreeing, an actuator loss. The verdict is left when ρ̂ has stayed
near 1 for a stated time.
"""

from __future__ import annotations

from numba import njit

from dftc_rt.control.signals import ACTUATOR_LOSS, ANOMALY, HEALTHY, NOT_OBSERVABLE

_CACHE = {"cache": True, "fastmath": False}


@njit(**_CACHE)
def log_likelihood_ratio(phi: float, y: float, rho: float, variance: float) -> float:
    """Log-likelihood ratio ln p(y | ρ)/p(y | 1) = ((y - φ)² - (y - ρ φ)²)/(2 R), dimensionless.

    Args:
        phi: Regressor φ, Nm.
        y: Measurement, Nm.
        rho: Alternative to ρ = 1.
        variance: R, Nm².
    """
    healthy = y - phi
    other = y - rho * phi
    return (healthy * healthy - other * other) / (2.0 * variance)


@njit(**_CACHE)
def shift_ratio(e: float, step: float, variance: float) -> float:
    """Log-likelihood ratio of a residual of mean ``step`` against one of mean 0.

    Args:
        e: Residual, Nm.
        step: Its mean under the alternative, Nm.
        variance: R, Nm².
    """
    return (e - 0.5 * step) * step / variance


@njit(**_CACHE)
def cusum(total: float, ratio: float, top: float) -> float:
    """One step of Page's cumulative sum, kept in [0, top].

    Args:
        total: Sum so far.
        ratio: Log-likelihood ratio of this sample.
        top: Bound, so that an anomaly that ends is forgotten in finite time.
    """
    return min(max(total + ratio, 0.0), top)


@njit(**_CACHE)
def clearing(elapsed: float, rho_hat: float, rho_clear: float, period: float) -> float:
    """Time for which ρ̂ has stayed at or above ``rho_clear``, s."""
    return elapsed + period if rho_hat >= rho_clear else 0.0


@njit(**_CACHE)
def verdict(
    before: float,
    loss: float,
    excess: float,
    rho_hat: float,
    clear_for: float,
    observable: bool,
    threshold_anomaly: float,
    threshold_loss: float,
    rho_loss: float,
    clear_s: float,
) -> float:
    """Verdict of this cycle, a value of :data:`dftc_rt.control.signals.VERDICTS`.

    Args:
        before: Verdict of the last cycle.
        loss: CUSUM of ρ below 1.
        excess: CUSUM of ρ above 1.
        rho_hat: ρ̂.
        clear_for: Time for which ρ̂ has been near 1, s.
        observable: Whether ρ can be observed now.
        threshold_anomaly: Sum that makes an anomaly.
        threshold_loss: Sum that makes an actuator loss.
        rho_loss: ρ̂ must be below this as well.
        clear_s: Time near 1 that ends an actuator loss, s.
    """
    if before == ACTUATOR_LOSS and clear_for < clear_s:
        return ACTUATOR_LOSS
    if before != ACTUATOR_LOSS and loss >= threshold_loss and rho_hat < rho_loss:
        return ACTUATOR_LOSS
    if max(loss, excess) >= threshold_anomaly:
        return ANOMALY
    return HEALTHY if observable else NOT_OBSERVABLE
