"""What the controller does when Panda's second drive or its encoder fails, and what was true."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.analysis import metrics
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.control import signals
from tests.integration.commands import rms

JOINT, I = "panda_joint2", 1  # noqa: E741
START_S, DURATION_S = 3.0, 4.5
BRAKE_CLOSE_S = 0.02
COUNT = 2 * np.pi / 524_288  # of Panda's encoders, rad
F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Ended:
    """A run with one fault from 3 s on.

    Attributes:
        state, reason: How it ended.
        missed: Answers that did not come.
        cycle, rig: Logged signals; joints in columns.
        joint: Metrics of the faulted joint.
        false_alarms: Of all joints.
        texts: What the events say.
    """

    state: str
    reason: str
    missed: int
    cycle: dict[str, F64]
    rig: dict[str, F64]
    joint: dict[str, Any]
    false_alarms: int
    texts: str

    def true(self, name: str, after_s: float = START_S) -> F64:
        """A column of /rig for the faulted joint from some time on."""
        return self.rig[name][self.rig["t"] > after_s - 1e-9, I]

    def verdicts(self) -> set[float]:
        """Verdicts on the faulted joint while it was controlled under the fault."""
        t, state = self.cycle["t"], self.cycle["state"]
        return set(self.cycle["verdict"][(t >= START_S) & ((state == 3) | (state == 4)), I])


def run(kind: str, keys: str = "", duration_s: float = DURATION_S) -> Ended:
    """Run Panda with one fault of its second joint."""
    fault = f'fault=[{{joint="{JOINT}", kind="{kind}", start_s={START_S}, {keys}}}]'
    found, outcome = run_simulation(
        open_session(
            "panda_shoulder_loss", [f"duration_s={duration_s}", fault.replace(", }", "}")]
        ),
        progress=False,
    )
    assert found.rig is not None
    joints = metrics.evaluate(found)["joints"]
    return Ended(
        outcome.end_state,
        outcome.reason,
        outcome.counters.missed,
        found.cycle,
        found.rig,
        joints[JOINT],
        sum(joint["false_alarms"] for joint in joints.values()),
        "\n".join(event.text for event in found.events),
    )


def healthy_motors(ended: Ended) -> None:
    """Check that /rig says: no motor has lost anything, and the fault is known."""
    np.testing.assert_array_equal(ended.rig["rho"], 1.0)
    before = ended.rig["t"] < START_S - 1e-9
    assert not ended.rig["fault"][before].any()
    others = np.delete(ended.rig["fault"], I, axis=1)
    assert not others.any()


def braked(ended: Ended, after_s: float) -> None:
    """Check that the faulted joint truly stands from some time on, and the whole arm at the end."""
    assert ended.true("v", START_S - 0.01)[0] != 0.0
    assert not ended.true("v", after_s).any()
    assert not ended.rig["v"][-1].any()


def fell_into_its_brake(ended: Ended) -> None:
    """Check that the joint lost its torque alone, and fell until its brake had closed."""
    last = ended.true("v", START_S + BRAKE_CLOSE_S - 0.002)[0]
    assert abs(last) > 0.1
    assert np.abs(ended.true("tau_applied", START_S + 0.015)).max() < 1e-4  # the current decays
    braked(ended, START_S + BRAKE_CLOSE_S + 0.002)
    assert not ended.true("tau_applied", START_S + BRAKE_CLOSE_S + 0.002).any()


def test_lock_in_place_is_a_lost_actuator_and_ends_in_a_safe_stop() -> None:
    ended = run("lock")
    assert ended.state == "safe stop"
    assert ended.reason == f"{JOINT}: estimated effectiveness below 0.15"
    assert ended.joint["detection_delay_s"] < 0.1
    assert ended.false_alarms == 0
    assert set(ended.true("rho")) == {0.0}
    assert set(ended.true("fault")) == {1.0}
    assert len(set(ended.true("q"))) == 1
    braked(ended, START_S + 0.001)


def test_an_emergency_stops_the_arm_at_once() -> None:
    ended = run("emcy", "error_code=0x4310")
    assert ended.state == "safe stop"
    assert ended.reason == f"{JOINT}: the drive reports a fault"
    assert "emergency 0x4310, register 0x09, node 2" in ended.texts
    assert ended.cycle["t"][-1] < START_S + 0.05
    healthy_motors(ended)
    assert set(ended.true("fault")) == {1.0}
    fell_into_its_brake(ended)


def test_silence_beyond_the_limit_stops_the_arm() -> None:
    ended = run("silent", "end_s=3.2")
    assert ended.reason == f"{JOINT}: no fresh feedback for 20 cycles"
    t, age = ended.cycle["t"], ended.cycle["age"][:, I]
    stopped = t[ended.cycle["state"] >= 5][0]
    assert stopped == pytest.approx(START_S + 0.020, abs=0.0015)
    assert age[np.searchsorted(t, START_S - 1e-9)] == 1
    healthy_motors(ended)
    # The drive heard no stop: its own watchdog closes the brake.
    assert ended.true("v", START_S + 0.015)[0] != 0.0
    braked(ended, START_S + 0.025)


def test_a_short_silence_is_survived_on_old_values() -> None:
    ended = run("silent", "end_s=3.01")
    assert (ended.state, ended.missed) == ("done", 10)
    assert ended.cycle["age"][:, I].max() == 10
    assert ended.verdicts() <= {signals.HEALTHY, signals.NOT_OBSERVABLE}
    assert ended.false_alarms == 0
    healthy_motors(ended)


def test_a_drive_that_has_booted_is_known_to_be_off() -> None:
    ended = run("restart", "boot_s=0.2")
    assert ended.reason == f"{JOINT}: no fresh feedback for 20 cycles"
    assert "did not say within" not in ended.texts
    # The boot-up message ends the wait for a drive that does not answer.
    assert ended.cycle["t"][-1] == pytest.approx(START_S + 0.2, abs=0.005)
    braked(ended, START_S + BRAKE_CLOSE_S + 0.002)


def test_late_answers_within_the_limit_are_survived() -> None:
    ended = run("late", "end_s=4.0, delay_s=0.005")
    assert (ended.state, ended.missed) == ("done", 5)
    assert ended.false_alarms == 0
    healthy_motors(ended)
    # While it lasts, the controller sees what was true five cycles before.
    t = ended.cycle["t"]
    k = np.flatnonzero((t > 3.1) & (t < 3.9))
    q, v = ended.rig["q"][:, I], ended.cycle["q"][:, I]
    assert np.abs(v[k] - q[k - 5]).max() < COUNT
    assert np.abs(v[k] - q[k]).max() > 10 * COUNT


def test_answers_later_than_the_limit_stop_the_arm() -> None:
    ended = run("late", "delay_s=0.05")
    assert ended.state == "safe stop"
    assert ended.reason == f"{JOINT}: no fresh feedback for 20 cycles"
    healthy_motors(ended)
    braked(ended, START_S + 0.06)


def test_a_restart_stops_the_arm_with_that_joint_already_in_its_brake() -> None:
    ended = run("restart", "boot_s=0.3")
    assert ended.state == "safe stop"
    assert ended.reason == f"{JOINT}: no fresh feedback for 20 cycles"
    healthy_motors(ended)
    fell_into_its_brake(ended)


def test_a_small_bias_moves_the_arm_off_and_nobody_is_told() -> None:
    ended = run("sensor_bias", "bias_rad=0.02", 6.0)
    assert ended.state == "done"
    healthy_motors(ended)
    assert ended.false_alarms == 0
    assert signals.ACTUATOR_LOSS not in ended.verdicts()
    late = np.flatnonzero((ended.cycle["t"] > 4.5) & (ended.cycle["t"] < 6.0))
    seen = ended.cycle["q"][late, I] - ended.cycle["qd"][late, I]
    true = ended.rig["q"][late, I] - ended.cycle["qd"][late, I]
    assert rms(seen) < 0.003
    assert np.mean(true) == pytest.approx(-0.02, abs=0.002)


def test_a_large_bias_is_taken_for_a_loss_and_counted_as_a_false_alarm() -> None:
    ended = run("sensor_bias", "bias_rad=0.2")
    assert ended.state == "safe stop"
    healthy_motors(ended)
    assert signals.ACTUATOR_LOSS in ended.verdicts()
    assert ended.joint["false_alarms"] >= 1
    assert ended.joint["detection_delay_s"] is None
    braked(ended, ended.rig["t"][-1])


def test_a_frozen_encoder_is_taken_for_a_loss_and_stops_the_arm() -> None:
    ended = run("sensor_frozen")
    assert ended.state == "safe stop"
    healthy_motors(ended)
    assert ended.joint["false_alarms"] >= 1
    at = ended.cycle["t"] > START_S - 1e-9
    assert len(set(ended.cycle["q"][at, I])) == 1
    assert np.ptp(ended.true("q")) > 0.01
    braked(ended, ended.rig["t"][-1])


def test_noise_is_seen_and_not_taken_for_a_loss() -> None:
    ended = run("sensor_noise", "position_rad=1e-4, velocity_rad_s=0.02")
    assert ended.state == "done"
    healthy_motors(ended)
    assert ended.false_alarms == 0
    k = np.flatnonzero((ended.cycle["t"] > 3.0) & (ended.cycle["t"] < 4.4))
    for name, std in (("q", 1e-4), ("v", np.hypot(0.02, 0.002))):
        error = ended.cycle[name][k, I] - ended.rig[name][k, I]
        assert np.std(error) == pytest.approx(std, rel=0.1)
        assert abs(np.mean(error)) < 0.1 * std


def test_lost_bits_are_a_coarse_encoder_and_not_taken_for_a_loss() -> None:
    ended = run("sensor_bits", "bits=8")
    assert ended.state == "done"
    healthy_motors(ended)
    assert ended.false_alarms == 0
    k = np.flatnonzero((ended.cycle["t"] > 3.0) & (ended.cycle["t"] < 4.4))
    steps = ended.cycle["q"][k, I] / (256 * COUNT)
    np.testing.assert_allclose(steps, np.rint(steps), rtol=0, atol=1e-6)
    assert len(set(np.rint(steps))) > 10
    below = ended.rig["q"][k, I] - ended.cycle["q"][k, I]
    assert below.min() > -COUNT
    assert below.max() < 257 * COUNT
