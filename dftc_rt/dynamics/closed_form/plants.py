"""The closed-form plants by name, behind one interface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from numba import njit

from dftc_rt.dynamics.closed_form import arm2, pendulums

Compiled = Callable[..., Any]
"""A function compiled by numba, callable from others that are."""


@dataclass(frozen=True)
class ClosedForm:
    """Equations of motion M(q) q̈ + bias(q, q̇) = u of n joints, compiled.

    Attributes:
        name: One of :data:`CLOSED_FORMS`.
        n: Number of joints.
        inverse_dynamics: ``(q, v, a, out)``: torque (n,), Nm.
        forward_dynamics: ``(q, v, tau, out)``: acceleration (n,), rad/s².
        mass_matrix: ``(q, out)``: M (n, n), kg m².
        local_terms: ``(q, v, sq, sv, sa, work, inertia, bias)``: the split (36) with the
            other joints at the surrogate state (sq, sv, sa), see :func:`_local_terms`.
    """

    name: str
    n: int
    inverse_dynamics: Compiled
    forward_dynamics: Compiled
    mass_matrix: Compiled
    local_terms: Compiled


def _local_terms(inverse_dynamics: Compiled, mass_matrix: Compiled) -> Compiled:
    """Return a compiled function that writes M_i and the bias of every joint.

    Its arguments are q, v (measured), sq, sv, sa (surrogate of the other joints), all (n,);
    ``work``, (4 + n, n), scratch; and ``inertia``, ``bias``, (n,), written, kg m² and Nm.
    Row i of the inverse dynamics is taken with joint i at its measured state and q̈_i = 0.
    M_ii is that at the surrogate position: for an open chain it does not depend on q_i.

    Source: [zhao2017] eq. (36).
    """

    @njit
    def local_terms(
        q: Any, v: Any, sq: Any, sv: Any, sa: Any, work: Any, inertia: Any, bias: Any
    ) -> None:
        n = q.shape[0]
        x, w, a, tau, mass = work[0], work[1], work[2], work[3], work[4:]
        mass_matrix(sq, mass)
        x[:] = sq
        w[:] = sv
        a[:] = sa
        for i in range(n):
            x[i], w[i], a[i] = q[i], v[i], 0.0
            inverse_dynamics(x, w, a, tau)
            inertia[i] = mass[i, i]
            bias[i] = tau[i]
            x[i], w[i], a[i] = sq[i], sv[i], sa[i]

    compiled: Compiled = local_terms
    return compiled


def _closed_form(
    name: str, inverse_dynamics: Compiled, forward_dynamics: Compiled, mass_matrix: Compiled
) -> ClosedForm:
    terms = _local_terms(inverse_dynamics, mass_matrix)
    return ClosedForm(name, 2, inverse_dynamics, forward_dynamics, mass_matrix, terms)


CLOSED_FORMS: Final = {
    form.name: form
    for form in (
        _closed_form(
            "pendulums",
            pendulums.state_form_inverse_dynamics,
            pendulums.state_form_forward_dynamics,
            pendulums.state_form_mass_matrix,
        ),
        _closed_form(
            "pendulums_physical",
            pendulums.physical_inverse_dynamics,
            pendulums.physical_forward_dynamics,
            pendulums.physical_mass_matrix,
        ),
        _closed_form("arm2", arm2.inverse_dynamics, arm2.forward_dynamics, arm2.mass_matrix),
    )
}
"""Plants by the names that ``robot.plant`` takes."""
