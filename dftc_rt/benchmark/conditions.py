"""Under what every run of the benchmark is made: robots, rig, times, seeds.

The rig is richer than the model that calibration fits: friction with stiction, presliding and a
part that grows with the load, and a payload that nobody mentioned.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

ROBOTS: Final[Mapping[str, str]] = {
    "panda": "panda_shoulder_loss",
    "ur5": "ur5_elbow_loss",
    "ur10": "ur10_shoulder_loss",
    "xarm7": "xarm7_shoulder_loss",
}
"""Robot -> shipped scenario, for its reference and the settings of its control."""

RIG: Final = (
    "rig.plant.payload_kg=1.0",
    'rig.plant.friction="lugre"',
    "rig.plant.coulomb_fraction=0.02",
    "rig.plant.viscous_fraction=0.01",
    "rig.plant.stribeck=1.3",
    "rig.plant.presliding_rad=2e-4",
    "rig.plant.load_friction=0.3",
    "rig.drive.encoder_bits=19",
    "rig.drive.velocity_noise_rad_s=0.002",
    "rig.drive.torque_lag_s=0.001",
    'bus.timing="off"',  # no bit times are counted; the records are the same
)
"""What the controller is not told, as overrides of a scenario; the delay is one cycle."""

BLEND_S: Final = 1.0
FAULT_S: Final = 3.0
"""Start of every fault, s: the healthy window is from 2 s on."""
RECOVERY_S: Final = 6.0
"""End of the fault of kind ``recovery``, s."""
END_S: Final = 8.0
"""Length of a run with a fault, and of its twin, s."""
NEGATIVE_S: Final = 30.0
"""Length of a run of the negative set, s."""

LOADED: Final = 0.05
"""A joint is loaded if the RMS of the twin's torque in the faulty window is over this part of
its limit."""
BEYOND_SHARE: Final = 0.01
"""A case is beyond the joint's authority if the twin's torque, filtered as the estimator does,
over ρ(t) exceeds the limit for more than this share of the time from the fault to its end."""

DRAWS: Final = ("tuning", "sealed")
# A sealed draw serves once: 300001 to 699999 were two, and what they showed changed the method.
_FIRST: Final = {
    ("faults", "tuning"): 100_001,
    ("negative", "tuning"): 200_001,
    ("faults", "sealed"): 700_001,
    ("negative", "sealed"): 800_001,
}
SEEDS: Final = 99_999
"""Seeds that a draw has. Calibration uses those from 1001 on."""


def seed(part: str, draw: str, index: int) -> int:
    """Seed of motion and noise of the run number ``index`` (from 0) of a part and draw.

    Raises:
        ValueError: The draw has no such seed.
    """
    if not 0 <= index < SEEDS:
        raise ValueError(f"seed {index} of at most {SEEDS}")
    return _FIRST[part, draw] + index


def seeds_of(part: str, draw: str) -> tuple[int, int]:
    """First and last seed of a part and draw."""
    first = _FIRST[part, draw]
    return first, first + SEEDS - 1
