"""What is told of each joint, from verdicts made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.control.signals import NAMES
from dftc_rt.log.run import Run
from dftc_rt.log.schema import cycle_layout, rig_layout
from dftc_rt.replay.verdicts import same_commands_until, told

PERIOD = 0.01


def run(rig: bool = True) -> Run:
    """Five seconds of two joints at 100 Hz; joint b has a fault from 2 s to 3 s."""
    layout, truth = cycle_layout(("a", "b"), NAMES), rig_layout(("a", "b"))
    cycles, rigs = np.zeros((500, layout.size)), np.zeros((500, truth.size))
    cycles[:, 0] = rigs[:, 0] = np.arange(500) * PERIOD
    cycles[:, 4] = 3.0
    made = Run.from_records(layout, cycles, rigs if rig else None)
    if made.rig is not None:
        made.rig["fault"][200:300, 1] = 1.0
    made.cycle["rho_hat"][:] = 0.7
    made.cycle["rho_std"][:, 0] = np.nan
    return made


def test_first_anomaly_first_cause_and_the_estimate_at_the_end() -> None:
    made = run()
    verdict = made.cycle["verdict"][:, 1]
    verdict[:100] = 4  # not observable: no anomaly
    verdict[210:220] = 7
    verdict[220:320] = 3
    verdict[320:] = 1
    made.cycle["rho_hat"][-1] = 0.6
    made.cycle["state"][-1:] = 7.0  # coming to rest: not judged
    a, b = told(made, made.cycle, PERIOD).values()
    assert (a.anomaly_s, a.attributed_s, a.verdict) == (None, None, None)
    assert (a.rho, a.rho_std) == (0.7, None)
    assert b.anomaly_s == pytest.approx(2.1)
    assert b.attributed_s == pytest.approx(2.2)
    assert b.verdict == 3
    assert (b.rho, b.rho_std) == (0.7, 0.0)


def test_false_is_what_is_said_of_a_joint_that_has_nothing() -> None:
    made = run()
    made.cycle["verdict"][50:80, 1] = 7  # before the fault
    made.cycle["verdict"][250:450, 1] = 1  # to 1.5 s after its end; one second is grace
    made.cycle["verdict"][250:262, 0] = 1  # the other joint
    a, b = told(made, made.cycle, PERIOD).values()
    assert a.alarms_s == pytest.approx(0.12)
    assert b.alarms_s == pytest.approx(0.51, abs=0.011)
    assert told(run(rig=False), made.cycle, PERIOD)["a"].alarms_s is None


def test_commands_are_compared_in_steps_of_the_drive() -> None:
    made, step = run(), np.array([0.1, 0.2])
    other = {name: rows.copy() for name, rows in made.cycle.items()}
    assert same_commands_until(made, other, np.ones(2), step) is None
    other["tau_cmd"][40] += [0.04, 0.09]
    assert same_commands_until(made, other, np.ones(2), step) is None
    other["tau_cmd"][70, 1] += 0.2
    assert same_commands_until(made, other, np.ones(2), step) == (float(made.cycle["t"][70]), "b")
    made.cycle["tau_cmd"][:] = 1.0
    other["tau_cmd"][:] = [1.0, 1.5]  # another torque constant: the same counts
    assert same_commands_until(made, other, np.array([1.0, 1.5]), step) is None
