"""The paper's contributions, each a test that says what is true of it.

1. One joint's fault does not reach the others. In continuous time it hardly does even without the
   gain; at 1 kHz it does, and the gain stops it once the loss is decided, not before.
2. The control law itself stays as it is: on the same feedback its output before the gain is the
   same to the last bit with fault tolerance and without, but for two stated ways.

The numbers:  python -m tests.paper.contributions
"""

from dataclasses import dataclass

import numpy as np
import pytest

from dftc_rt.cli.session import open_session
from dftc_rt.control.dftc import Dftc
from dftc_rt.control.interface import NONFINITE_LAW
from dftc_rt.control.signals import AD, AGE, NAMES, QD, RHO_HAT, TAU_CMD, TAU_LAW, VD, Q, V
from dftc_rt.rt.supervisor import State
from tests.paper.contributions import Reach, at_1_khz, continuous, recorded

EXAMPLES = [1, 2]
PANDA = "panda_shoulder_loss"
SHORT = ("duration_s=5.0", "fault[0].start_s=2.0")
RTOL = 1e-6
OWN, OTHERS = 0, 1


# 1. how far a fault reaches


@pytest.mark.parametrize("example", EXAMPLES)
def test_in_continuous_time_the_printed_law_confines_the_fault_without_the_gain(
    example: int,
) -> None:
    """δ̂ and ξ̂ hold against it: the other joint moves a thousandth of the faulty one."""
    found = continuous(example, "none", RTOL)
    assert 0.1 < found.moved_peak[OWN] < 1.0
    assert found.moved_peak[OTHERS] < 2e-3 * found.moved_peak[OWN]
    assert found.error[OTHERS] == pytest.approx(found.error_twin[OTHERS], rel=1e-2)


def test_in_continuous_time_it_does_reach_the_other_joint_of_the_arm() -> None:
    """Little as it is, it is more than the solver's error: with the true ρ nothing else is left."""
    found, floor = continuous(2, "none", RTOL), continuous(2, "true", RTOL)
    assert floor.moved_peak[OWN] < 2e-4
    assert 5.0 * floor.moved[OTHERS] < found.moved[OTHERS] < 1e-3


@pytest.mark.parametrize("example", EXAMPLES)
def test_in_continuous_time_the_gain_is_for_the_faulty_joint(example: int) -> None:
    without, with_gain = (continuous(example, gain, RTOL) for gain in ("none", "desired"))
    assert with_gain.moved[OWN] < 0.02 * without.moved[OWN]
    assert with_gain.moved_peak[OTHERS] < 1e-3
    assert with_gain.error[OTHERS] == pytest.approx(with_gain.error_twin[OTHERS], rel=1e-2)


def _arm(law: str) -> Reach:
    return at_1_khz(PANDA, law, *SHORT)


def test_with_the_gain_the_healthy_joints_of_an_arm_keep_their_error() -> None:
    found = _arm("dftc")
    assert found.error[OTHERS] < 1.25 * found.error_twin[OTHERS]
    assert found.error[OWN] < 1.25 * found.error_twin[OWN]
    assert found.moved[OTHERS] < 0.05
    assert found.torque[OTHERS] < 0.03


def test_without_the_gain_the_fault_reaches_them() -> None:
    found, tolerant = _arm("dftc, gain off"), _arm("dftc")
    assert found.error[OTHERS] > 1.7 * found.error_twin[OTHERS]
    assert found.moved[OTHERS] > 4.0 * tolerant.moved[OTHERS]
    assert found.torque[OTHERS] > 3.0 * tolerant.torque[OTHERS]
    assert found.moved[OWN] > 300.0 * tolerant.moved[OWN]


def test_the_first_shove_comes_before_the_decision() -> None:
    """The gain waits for the verdict: what the others feel until then it does not take away."""
    found, tolerant = _arm("dftc, gain off"), _arm("dftc")
    assert 1.0 < tolerant.moved_peak[OTHERS] < 3.0
    assert tolerant.moved_peak[OTHERS] > 0.8 * found.moved_peak[OTHERS]
    assert tolerant.torque_peak[OTHERS] > 0.8 * found.torque_peak[OTHERS]


def test_computed_torque_hands_the_fault_to_all_joints() -> None:
    """Through M(q)⁻¹, and with no term that would hold against it."""
    found, law = _arm("computed torque"), _arm("dftc, gain off")
    assert found.error[OTHERS] > 50.0 * found.error_twin[OTHERS]
    assert found.error[OTHERS] > 0.5 * found.error[OWN]
    assert found.moved[OTHERS] > 30.0 * law.moved[OTHERS]


def test_in_example_2_at_1_khz_the_gain_makes_the_difference() -> None:
    runs = {law: at_1_khz("paper_example2", law, "duration_s=7") for law in LAWS_OF_EXAMPLE_2}
    tolerant, without, floor = runs.values()
    assert tolerant.error[OTHERS] < 1.1 * tolerant.error_twin[OTHERS]
    assert without.error[OTHERS] > 5.0 * without.error_twin[OTHERS]
    assert without.error[OTHERS] > 0.5 * without.error[OWN]
    assert floor.error[OTHERS] > 5.0 * without.error[OTHERS]


LAWS_OF_EXAMPLE_2 = ("dftc", "dftc, gain off", "computed torque")


# 2. the law before the gain


@dataclass
class Replay:
    """What a law makes of recorded feedback: records (K, 15, n), status (K,), limits (n,)."""

    rec: np.ndarray
    status: np.ndarray
    limit: np.ndarray

    def same(self, other: "Replay") -> np.ndarray:
        """Whether the law before the gain is the same to the bit, (K,)."""
        a, b = self.rec[:, TAU_LAW], other.rec[:, TAU_LAW]
        return np.asarray((a.view(np.int64) == b.view(np.int64)).all(axis=1))


FEEDBACK = ((Q, "q"), (V, "v"), (QD, "qd"), (VD, "vd"), (AD, "ad"), (AGE, "age"))


def _replay(*settings: str, ftc: bool, limit: float | None = None) -> Replay:
    """Feed what a Panda measured under the fault to a law with other settings, or limits in Nm."""
    cycle = recorded(PANDA, *SHORT).cycle
    overrides = [*SHORT, f"control.ftc={str(ftc).lower()}"]
    parts = open_session(PANDA, [*overrides, *(f"control.{s}" for s in settings)]).parts
    count, n = cycle["q"].shape
    rec, status = np.zeros((count, len(NAMES), n)), np.zeros(count, dtype=int)
    if limit is not None:
        assert isinstance(parts.law, Dftc)
        parts.law.storage.parameters["limit"] = limit
    parts.law.start(cycle["q"][0], cycle["v"][0])
    for k in range(count):
        for index, name in FEEDBACK:
            rec[k, index] = cycle[name][k]
        parts.terms.update(*(rec[k, index] for index in (Q, V, QD, VD, AD)))
        status[k] = parts.law.update(rec[k], parts.terms.inertia, parts.terms.bias)
    return Replay(rec, status, parts.torque_limit)


REGULAR = (
    "law=paper", "gains.layer=0.3", "gains.dead_zone=0.03", "gains.leak_delta=1.0",
    "gains.leak_xi=1.0", "gains.g_min=0.5", "gains.s_bound=10.0",
)  # fmt: skip
SAME = {
    "dftc": (),
    "dftc, gradient": ("gains.observer=gradient",),
    "dftc, networks adapting": (
        "gains.gamma_f=1.0", "gains.gamma_g=0.01", "gains.freeze_saturated=off",
    ),
    "paper": ("law=paper",),
    "paper, made to run": REGULAR,
    "paper on the split": (
        "law=paper", "gains.model=split", "gains.observer=kalman", "gains.w_f=0", "gains.w_g=0",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", SAME)
def test_on_the_same_feedback_the_law_before_the_gain_is_the_same_bits(case: str) -> None:
    tolerant, without = (_replay(*SAME[case], ftc=ftc) for ftc in (True, False))
    assert not tolerant.status.any()
    assert tolerant.same(without).all()
    # and the rest is not: the gain acts, and the estimators know what was told to the drives
    assert (tolerant.rec[:, TAU_CMD] != without.rec[:, TAU_CMD]).any()
    assert np.abs(tolerant.rec[:, RHO_HAT] - without.rec[:, RHO_HAT]).max() > 0.05


def test_the_replay_is_the_run() -> None:
    cycle = recorded(PANDA, *SHORT).cycle
    replay = _replay(ftc=True)
    asked = cycle["state"] != State.FAULT  # the drives are off then, and the law is not asked
    assert np.count_nonzero(asked) > 5000
    np.testing.assert_array_equal(replay.rec[asked, TAU_LAW], cycle["tau_law"][asked])
    # the velocity at the start is not in the record; the filters forget it
    np.testing.assert_allclose(replay.rec[asked, RHO_HAT], cycle["rho_hat"][asked], atol=1e-7)


def test_it_is_not_where_adaptation_waits_for_an_amplified_command_that_saturates() -> None:
    """``freeze_saturated``, on in ``dftc``: with networks that learn, the gain gets into the law.

    Here the replayed estimate falls to ρ_min: the feedback does not answer to the gain.
    """
    learning = SAME["dftc, networks adapting"][:2]
    tolerant, without = (_replay(*learning, ftc=ftc) for ftc in (True, False))
    same = tolerant.same(without)
    assert not same.all()
    first = int(np.argmin(same))
    (joint,) = np.flatnonzero(tolerant.rec[first, TAU_LAW] != without.rec[first, TAU_LAW])
    law, told = (tolerant.rec[:first, row, joint] for row in (TAU_LAW, TAU_CMD))
    assert (np.abs(law) < tolerant.limit[joint]).all()
    at_limit = np.abs(told) >= tolerant.limit[joint] * (1.0 - 1e-12)
    assert at_limit.any()
    assert np.argmax(at_limit) >= first - 5  # the pause shows as soon as s leaves the dead zone


def test_nor_is_it_so_with_the_defaults_where_the_torque_does_not_suffice() -> None:
    """δ̂ and ξ̂ wait as well: a drive that the law alone would not saturate, but the gain does."""
    enough = 1.01 * float(np.abs(_replay(ftc=False).rec[:, TAU_LAW]).max())
    tolerant, without = (_replay(ftc=ftc, limit=enough) for ftc in (True, False))
    assert not tolerant.same(without).all()
    adapting = "gains.freeze_saturated=off"
    tolerant, without = (_replay(adapting, ftc=ftc, limit=enough) for ftc in (True, False))
    assert tolerant.same(without).all()


def test_it_is_not_where_the_printed_observer_overflows() -> None:
    """Without the identifier's terms ρ̂ of (29) may leave the finite numbers: 0 Nm then.

    At 1 kHz on this run it did so with five of eight Γ_ρ that were tried, the printed 2000 among
    them; with 10⁶ the explicit step of (29) leaves it no choice.
    """
    printed = ("law=paper", "gains.observer_correction=off", "gains.gamma_rho=1e6")
    tolerant, without = (_replay(*printed, ftc=ftc) for ftc in (True, False))
    first = int(np.argmax(tolerant.status != 0))
    assert tolerant.status[first] == NONFINITE_LAW
    assert not without.status[: first + 1].any()
    assert tolerant.same(without)[:first].all()
    assert not tolerant.same(without)[first]
