"""A law of your own: local PID with the model's own terms, beside the fault-tolerant one.

python examples/own_law.py
cd examples && dftc hil panda_shoulder_loss --set control.law=own_law:LocalPid
"""

import numpy as np

from dftc_rt.analysis.metrics import evaluate
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.control.plugin import Given, TorqueLaw


class LocalPid(TorqueLaw):
    """u_i = M_i (q̈_d - (λ + k) ė - λ k e - k_i ∫e dt) + bias_i: what joint i measures, no more."""

    uses_local_terms = True

    def __init__(self, given: Given) -> None:
        super().__init__(given)
        lam, k = given.gain("lam", 8.0), given.gain("k", 40.0)
        self.kp, self.kd = lam * k, lam + k
        self.ki = given.gain("ki", 200.0)
        self.start(np.zeros_like(lam), np.zeros_like(lam))

    def start(self, q, v):
        """Forget the integral."""
        self.sum = np.zeros_like(q)

    def torque(self, q, v, qd, vd, ad):
        """One cycle, all joints at once: Nm."""
        error = q - qd
        self.sum += error * self.given.joints.period_s
        wanted = ad - self.kd * (v - vd) - self.kp * error - self.ki * self.sum
        return self.inertia * wanted + self.bias


def main() -> None:
    """Take 40 % off Panda's shoulder under both laws."""
    for law in ("own_law:LocalPid", "dftc"):
        settings = [f"control.law={law}", "duration_s=10"]
        run, outcome = run_simulation(open_session("panda_shoulder_loss", settings))
        found = evaluate(run)["joints"]["panda_joint2"]
        before, after = found["rmse_healthy_mrad"], found["rmse_faulty_mrad"]
        print(
            f"{law:18} {outcome.end_state}: {before:6.3f} mrad before the loss, {after:6.3f} after "
            f"it, {found['peak_after_fault_mrad']:5.2f} at worst"
        )


if __name__ == "__main__":
    main()
