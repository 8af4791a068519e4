"""A test torque: a joint asks its own motor how much of a command arrives.

While an anomaly is not attributed, commands hardly move and a weak motor looks like a load.
Worse, they move *because of* the disturbance, so that a regression of the torque that the motion
needed on the torque that was commanded finds a loss where there is none. A known torque, added
on purpose, is the classical remedy: what correlates with it was caused by the motor.

The torque is a sine of a few periods, ``probe`` of the limit. Both φ (what a healthy drive
would have delivered) and y (what the motion needed by the local model) are correlated with it
under a Hann window and orthogonally to any parabola, so that slow motion and slow disturbances
drop out. Their complex ratio is ρ times

    G = M_ii s² [(M s² + (D s + K) exp(-s T))⁻¹]_ii,    s = jω,

because at that frequency the other joints give way under their own feedback, late by T,
D_j = M_jj (λ_j + k_j), K_j = M_jj λ_j k_j, and the local y counts them as standing still. G comes
from the model at the desired pose, known before the run. Neighbours test at different
frequencies, a whole number of periods within the window apart: tests that run together are
orthogonal, and those that overlap in part leave a quarter of a neighbour's wave at most.

How much of the ratio is chance is seen beside it: what y has at one period more and one less that
φ there does not explain. An edge within the window, as when a contact ends, is as large there.

Source: instrumental variables in closed loop, [ljung1999]; active diagnosis, [niemann2006];
noise from the lines beside the excited one, [pintelon2012] section 4.3.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit

from dftc_rt.control import attribution
from dftc_rt.control.interface import F64

_CACHE = {"cache": True, "fastmath": False}

PERIODS: Final = (5, 7, 9, 11, 13, 15)
"""Periods within a window, by joint number modulo 6."""
COSINE: Final = 0
SINE: Final = 1
SHAPE: Final = 6
"""Columns of a table: the two correlations, and the torque itself, in 1."""
BESIDE: Final = ((2, -1), (4, 1))
"""Columns of cosines that have fewer or more periods, and how many; their sines follow."""
_PHI: Final = 0
_Y: Final = 1
_HEARD: Final = 6
SUMS: Final = (2, _HEARD)
"""Shape of the sums of one test: φ and y, along all correlations."""

IDLE: Final = -1
ASKED: Final = -2
"""Values of the state ``probe_at`` besides the number of the sample: no test, G is wanted."""

_GAP_S: Final = 0.04  # between tests, so that one has rung down before the next
_PAUSE_S: Final = 1.0  # between later ones
_SURE_S: Final = 10.0  # and when nothing is left to ask
_SENT: Final = 0.5  # of the wave has to be in the command
_QUADRATURE: Final = 0.25  # out of phase, and
_LEAST: Final = -0.1
_LARGEST: Final = 1.35  # in phase: no motor does that, the test was disturbed
_MOST: Final = 6  # tests of one anomaly that follow each other
_SLOW: Final = 0.02  # rad/s: below it friction may hold the joint against the test
_SLOW_SHARE: Final = 0.35  # of a window that may be so slow
_OTHERWISE: Final = 0.98
"""Ratio when no torque is lost."""
_STD: Final = 0.045
"""Standard deviation of an undisturbed test's ratio, for a joint whose neighbours hold still."""
_COUPLED: Final = 3.0
"""|G| from which the neighbours' answer dominates, and its errors with it."""
_MOST_COUPLED: Final = 4.0
"""|G| beyond which a test proves nothing."""
_ENOUGH: Final = 15.0
"""Most evidence that tests gather, nats."""
_FEW: Final = 2.0  # a spread that is known from two lines alone may be larger
_WORSE: Final = 0.15
"""More loss than at the last test, from which that one does not count any more."""
_BOUND: Final = 3.0
"""Largest distance that counts, in standard deviations."""


def table(n: int, period_s: float, probe_s: F64) -> tuple[F64, np.ndarray[Any, Any]]:
    """Correlations and torque of every joint's test.

    Args:
        n: Number of joints.
        period_s: Control period, s.
        probe_s: Length of the window, (n,), s.

    Returns:
        (n, longest, 7), zero beyond a joint's own length; and the lengths in samples, (n,).
    """
    lengths = np.maximum(np.round(probe_s / period_s).astype(np.int64), 4 * PERIODS[-1])
    out = np.zeros((n, int(lengths.max()), SHAPE + 1))
    for i, length in enumerate(lengths):
        periods = PERIODS[i % len(PERIODS)]
        turn = 2.0 * np.pi * (np.arange(length) + 0.5) / length
        window = np.hanning(length + 2)[1:-1]
        t = np.linspace(-1.0, 1.0, length)
        slow = np.stack([np.ones_like(t), t, t * t], axis=1)
        # Remove from each correlation its part along the parabolas, in the window's norm.
        normal = slow.T @ (window[:, None] * slow)
        for column, more in ((COSINE, 0), *BESIDE):
            phase = (periods + more) * turn
            waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)
            along = np.linalg.solve(normal, slow.T @ (window[:, None] * waves))
            out[i, :length, column : column + 2] = window[:, None] * (waves - slow @ along)
        out[i, :length, SHAPE] = np.sin(periods * turn)
    return out, lengths


def sizes(correlations: F64) -> F64:
    """What the correlations make of the wave itself, (n,), for an amplitude of 1."""
    shape = correlations[:, :, SHAPE]
    cosine = np.einsum("ik,ik->i", correlations[:, :, COSINE], shape)
    sine = np.einsum("ik,ik->i", correlations[:, :, SINE], shape)
    size: F64 = np.hypot(cosine, sine)
    return size


def frequency(i: int, length_s: float) -> float:
    """Angular frequency of joint i's test, rad/s, for a window of ``length_s`` seconds."""
    return 2.0 * np.pi * PERIODS[i % len(PERIODS)] / length_s


def response(mass: F64, own: F64, i: int, omega: float, lam: F64, k: F64, dead_s: F64) -> complex:
    """G of joint i: needed torque by the local model over delivered torque.

    Args:
        mass: M(q) as it is, (n, n), kg m².
        own: M_jj(q) as the laws believe, (n,), kg m².
        i: Joint.
        omega: Angular frequency, rad/s.
        lam: λ, (n,), 1/s.
        k: Feedback gains, (n,), 1/s.
        dead_s: From a measurement to the torque that answers it, (n,), s.
    """
    s = 1j * omega
    feedback = own * ((lam + k) * s + lam * k) * np.exp(-s * dead_s)
    feedback[i] = 0.0  # the joint's own feedback is in the delivered torque
    column = np.zeros(mass.shape[0])
    column[i] = 1.0
    try:
        moved = np.linalg.solve(mass * s * s + np.diag(feedback), column)
    except np.linalg.LinAlgError:  # inertia that no arm has, from a load that is none
        return complex(math.inf)
    return complex(own[i] * s * s * moved[i])


@njit(**_CACHE)
def forget(x: Any) -> None:
    """Forget all tests: a new anomaly begins, or an old one has ended."""
    x.probe_at = IDLE
    x.probe_count = 0
    x.probe_tries = 0
    x.probe_evidence = 0.0
    x.probe_wait = 0.0


@njit(**_CACHE)
def sample(
    p: Any, x: Any, sums: F64, correlations: F64, phi: float, y: float, v_d: float, span: int
) -> None:
    """Take one sample of a running test.

    Args:
        p: Parameters.
        x: State.
        sums: Of the test, :data:`SUMS`, updated.
        correlations: (longest, 7) of :func:`table`.
        phi: φ of the last interval, not filtered, Nm.
        y: What the motion of that interval needed, not filtered, Nm.
        v_d: Desired velocity, rad/s.
        span: Cycles that the sample covers; a gap ends the test without a result.
    """
    at = x.probe_at
    if at < 0:
        return
    if span != 1:
        stop(x)
        return
    for column in range(_HEARD):
        sums[_PHI, column] += correlations[at, column] * phi
        sums[_Y, column] += correlations[at, column] * y
    if abs(v_d) < _SLOW:
        x.probe_slow += 1
        if x.probe_slow > _SLOW_SHARE * p.probe_length:
            stop(x)
            return
    x.probe_at = at + 1
    if at + 1 == p.probe_length:
        finish(p, x, sums)


@njit(**_CACHE)
def stop(x: Any) -> None:
    """End a test; the next waits longer after many, and long when they have said all there is."""
    x.probe_at = IDLE
    x.probe_tries += 1
    x.probe_wait = _GAP_S if x.probe_tries < _MOST else _PAUSE_S
    if abs(x.probe_evidence) >= _ENOUGH:
        x.probe_wait = _SURE_S


@njit(**_CACHE)
def finish(p: Any, x: Any, sums: F64) -> None:
    """Turn the sums of a complete test into a ratio, and add its evidence to that of others."""
    stop(x)
    g = complex(x.probe_g_re, x.probe_g_im)
    sent = line(sums, _PHI, COSINE)
    if abs(sent) < _SENT * p.probe_size:  # saturation or coarse steps ate the wave
        return
    heard = line(sums, _Y, COSINE) / sent
    ratio = heard / g
    x.probe_re, x.probe_im = ratio.real, ratio.imag
    x.probe_std = chance(sums, heard) / abs(sent * g)
    if abs(ratio.imag) > _QUADRATURE or not _LEAST < ratio.real < _LARGEST:
        return
    x.probe_count += 1
    coupled = abs(complex(x.probe_g_re, x.probe_g_im)) / _COUPLED
    std = math.hypot(_STD * max(1.0, coupled * coupled), _FEW * x.probe_std)
    x.probe_level = 1.0 - x.h_loss
    total = x.probe_evidence + evidence(
        ratio.real, ratio.imag, 1.0 - x.h_loss, min(x.probe_other, _OTHERWISE), std
    )
    x.probe_evidence = min(max(total, -_ENOUGH), _ENOUGH)


@njit(**_CACHE)
def line(sums: F64, signal: int, column: int) -> complex:
    """Fourier coefficient of a signal of a test.

    Args:
        sums: Of the test, :data:`SUMS`.
        signal: Row.
        column: Column of the cosine.
    """
    return complex(sums[signal, column], -sums[signal, column + 1])


@njit(**_CACHE)
def chance(sums: F64, heard: complex) -> float:
    """Standard deviation of a Fourier coefficient of y, Nm: what is beside it without a cause.

    Of two coefficients, with two components each. What the test itself leaks into them cancels, and
    half of the error with it when an edge is in the middle of the window.

    Args:
        sums: Of the test, :data:`SUMS`.
        heard: y over φ, complex, at the frequency of the test.
    """
    square = 0.0
    for column, _ in BESIDE:
        left = line(sums, _Y, column) - heard * line(sums, _PHI, column)
        square += left.real * left.real + left.imag * left.imag
    return math.sqrt(0.25 * square)


@njit(**_CACHE)
def revise(x: Any) -> None:
    """Forget what tests said against a loss when the residual suggests a larger one by now."""
    if x.probe_evidence < 0.0 and 1.0 - x.h_loss < x.probe_level - _WORSE:
        x.probe_evidence = 0.0
        x.probe_wait = min(x.probe_wait, _GAP_S)


@njit(**_CACHE)
def evidence(ratio: float, quadrature: float, level: float, other: float, std: float) -> float:
    """Log-likelihood ratio of a loss against everything else that one test gives, nats.

    A loss makes the ratio agree with the ρ that the residual itself suggests; a contact or
    friction leaves it near 1, a load near what its inertia makes of it. Both distances are
    bounded, so that a test that was spoilt, and agrees with neither, says nothing; what is out
    of phase is a measure of how much it was.

    Args:
        ratio: Part of the test torque that arrived.
        quadrature: The same out of phase, which no explanation foresees.
        level: 1 - the loss that the residual suggests.
        other: The least ratio that no loss explains.
        std: Standard deviation of the test's ratio.
    """
    variance = std * std + quadrature * quadrature
    other = min(ratio - other, 0.0)
    loss = ratio - level
    bound = _BOUND * _BOUND
    gain: float = 0.5 * (min(other * other / variance, bound) - min(loss * loss / variance, bound))
    return gain


@njit(**_CACHE)
def ask(p: Any, x: Any, residual: float, std: float, v_d: float) -> bool:
    """Whether this joint wants a test now, and so its G.

    Args:
        p: Parameters.
        x: State.
        residual: y - φ, filtered, Nm.
        std: Its standard deviation, Nm.
        v_d: Desired velocity, rad/s.
    """
    if p.probe <= 0.0 or x.probe_at != IDLE:
        return False
    x.probe_wait -= p.period
    if x.since < p.probe_wait_s or x.probe_wait > 0.0:
        return False
    if abs(residual) < 3.0 * std or abs(v_d) < _SLOW or not attribution.suspect(p, x):
        return False
    x.probe_at = ASKED
    return True


@njit(**_CACHE)
def torque(p: Any, x: Any, correlations: F64) -> float:
    """Test torque of this cycle, Nm."""
    if x.probe_at < 0 or x.probe_at >= p.probe_length:
        return 0.0
    wave: float = p.probe * p.limit * correlations[x.probe_at, SHAPE]
    return wave


def answer(state: Any, sums: F64, i: int, g: complex | None, loaded: complex | None = None) -> None:
    """Start the test that joint i asked for.

    Args:
        state: (n,) of :data:`dftc_rt.control.layout.STATE`.
        sums: Of all tests, (n, 2, 6); those of joint i are set to zero.
        i: Joint.
        g: From :func:`response`; None: nobody knows it, and there is no test. No test either,
            for now, where the neighbours' answer is most of what would come back.
        loaded: The response with the load that would explain the residual; None: unknown.
    """
    state["probe_at"][i] = IDLE
    if g is None or not abs(g) <= _MOST_COUPLED:
        state["probe_wait"][i] = math.inf if g is None else _PAUSE_S
        return
    state["probe_at"][i] = 0
    state["probe_slow"][i] = 0
    sums[i] = 0.0
    state["probe_g_re"][i], state["probe_g_im"][i] = g.real, g.imag
    state["probe_other"][i] = _OTHERWISE if loaded is None else (loaded / g).real
