"""The negative set: motion and disturbances of a healthy robot, on which every alarm is false."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.analysis.faults import running_mask
from dftc_rt.benchmark.cases import Gain, Group
from dftc_rt.benchmark.conditions import BLEND_S, NEGATIVE_S
from dftc_rt.benchmark.measure import wrong_gain_s
from dftc_rt.control.signals import ACTUATOR_LOSS, HEALTHY, NOT_OBSERVABLE
from dftc_rt.log.run import Run

F64 = NDArray[np.float64]

_STEP_S: Final = (8.0, 20.0)  # a payload comes and goes
_FRICTION_S: Final = 8.0
_CONTACT_S: Final = 0.3
_CONTACT_N: Final = 20.0
_CONTACTS: Final = (
    (4.0, (1, 0, 0)), (8.0, (0, 0, -1)), (12.0, (0, 1, 0)),
    (16.0, (-1, 0, 0)), (20.0, (0, 0, 1)), (24.0, (0, -1, 0)),
)  # fmt: skip
_SETTLED_S: Final = 2.0


@dataclass(frozen=True)
class Item:
    """One of the set.

    Attributes:
        name: As in the results.
        motion: ``multisine``, ``sine``, ``hold``, or ``moves``: waypoints drawn at random.
        amplitude: rad, about home.
        frequency: Of sines, Hz; of moves, the time of one and of the rest after it, s.
        fault: What disturbs the robot: TOML of the key ``fault``.
        title: For people.
    """

    name: str
    motion: str
    amplitude: float = 0.0
    frequency: tuple[float, float] = (0.1, 0.5)
    fault: str = "[]"
    title: str = ""


def _payload(kg: float) -> str:
    return f'[{{kind="payload", payload_kg={kg}, start_s={_STEP_S[0]}, end_s={_STEP_S[1]}}}]'


def _contacts() -> str:
    tables = [
        f'{{kind="contact", start_s={t}, end_s={t + _CONTACT_S}, '
        f"force_n={[_CONTACT_N * x for x in way]}}}"
        for t, way in _CONTACTS
    ]
    return f"[{', '.join(tables)}]"


_BAND: Final = (0.1, 0.5)
ITEMS: Final = (
    # twelve trajectories
    Item("multisine", "multisine", 0.35, _BAND),
    Item("multisine small", "multisine", 0.2, _BAND),
    Item("multisine large", "multisine", 0.5, (0.05, 0.3)),
    Item("multisine fast", "multisine", 0.15, (0.3, 0.9)),
    Item("multisine faster", "multisine", 0.25, (0.2, 0.7)),
    Item("multisine low", "multisine", 0.3, (0.05, 0.2)),
    Item("sine 0.2 Hz", "sine", 0.3, (0.2, 0.2)),
    Item("sine 0.5 Hz", "sine", 0.15, (0.5, 0.5)),
    Item("moves 3 s", "moves", 0.4, (3.0, 0.0)),
    Item("moves 3 s, rests", "moves", 0.5, (3.0, 1.0)),
    Item("moves 2 s", "moves", 0.3, (2.0, 0.5)),
    Item("moves 4 s", "moves", 0.6, (4.0, 0.0)),
    # what disturbs a healthy robot
    Item("payload 0.5 kg", "multisine", 0.35, _BAND, _payload(0.5)),
    Item("payload 1 kg", "multisine", 0.35, _BAND, _payload(1.0)),
    Item("payload 1 kg, hold", "hold", 0.0, _BAND, _payload(1.0)),
    Item("contacts", "multisine", 0.35, _BAND, _contacts()),
    Item("contacts, hold", "hold", 0.0, _BAND, _contacts()),
    Item("hold", "hold"),
    Item("slow", "multisine", 0.25, (0.01, 0.05)),
    Item("friction x 1.5", "multisine", 0.35, _BAND,
         f'[{{kind="friction", factor=1.5, start_s={_FRICTION_S}}}]'),
    Item("jumps", "moves", 0.4, (1.0, 1.5)),
)  # fmt: skip
"""Every one of :data:`~dftc_rt.benchmark.conditions.NEGATIVE_S` seconds."""


def item_settings(item: Item, seed: int, home: F64, lower: F64, upper: F64) -> list[str]:
    """Overrides of a scenario for an item.

    Args:
        item: The item.
        seed: Of its random numbers.
        home: Home pose, (n,), rad.
        lower: Lower limits, (n,), rad.
        upper: Upper limits, (n,), rad.
    """
    found = [f"duration_s={NEGATIVE_S}", f"reference.blend_s={BLEND_S}", f"fault={item.fault}"]
    if item.motion == "moves":
        times, poses = _moves(item, seed, home, lower, upper)
        return [
            *found, 'reference.kind="waypoints"', f"reference.times_s={times}",
            f"reference.positions_rad={poses}",
        ]  # fmt: skip
    band = f"{list(item.frequency)}" if item.motion == "multisine" else f"{item.frequency[0]}"
    return [
        *found, f'reference.kind="{item.motion}"', f"reference.amplitude_rad={item.amplitude}",
        f"reference.frequency_hz={band}",
    ]  # fmt: skip


def _moves(
    item: Item, seed: int, home: F64, lower: F64, upper: F64
) -> tuple[list[float], list[list[float]]]:
    """Poses at random about home, within limits, with a rest after each move."""
    rng = np.random.default_rng(seed)
    move_s, rest_s = item.frequency
    margin = 0.05 * np.minimum(upper - lower, 2.0 * np.pi)
    times, poses = [0.0], [home.tolist()]
    while times[-1] < NEGATIVE_S:
        drawn = home + rng.uniform(-item.amplitude, item.amplitude, home.shape)
        pose = np.clip(drawn, lower + margin, upper - margin)
        times.append(round(times[-1] + move_s, 6))
        poses.append([round(float(x), 6) for x in pose])
        if rest_s > 0.0:
            times.append(round(times[-1] + rest_s, 6))
            poses.append(poses[-1])
    return times, poses


def item_id(group: Group, item: str) -> str:
    """Stable name of a run of the negative set."""
    return f"{group.id}/{item}"


def measure_negative(run: Run, gain: Gain, period_s: float) -> dict[str, Any]:
    """Columns of a run of the negative set, by name.

    Args:
        run: A run without a fault of an actuator.
        gain: When the law's ρ̂ acts.
        period_s: Control period, s.
    """
    running = running_mask(run)
    verdict = np.where(running[:, None], run.cycle["verdict"], HEALTHY)
    loss = verdict == ACTUATOR_LOSS
    anomaly = ~np.isin(verdict, (HEALTHY, NOT_OBSERVABLE))
    late = running & (run.cycle["t"] >= _SETTLED_S)
    error = 1e3 * (run.cycle["qd"] - run.cycle["q"])[late]
    return {
        "false_alarms": entries(loss),
        "false_alarm_s": float(np.count_nonzero(loss)) * period_s,
        "wrong_gain_s": wrong_gain_s(run, (), gain, period_s),
        "anomalies": entries(anomaly),
        "anomaly_s": float(np.count_nonzero(anomaly)) * period_s,
        "joints": " ".join(name for name, any_ in zip(run.joints, loss.any(axis=0), strict=True)
                           if any_),
        "worst_mrad": float(np.sqrt(np.mean(error**2, axis=0)).max()) if len(error) else None,
    }  # fmt: skip


def entries(raised: NDArray[np.bool_]) -> int:
    """How often any column of (K, n) goes from False to True; the first row counts."""
    before = np.vstack([np.zeros((1, raised.shape[1]), np.bool_), raised[:-1]])
    return int(np.count_nonzero(raised & ~before))
