"""The grid: laws, kinds of fault, and the runs that make up a case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from dftc_rt.benchmark.conditions import BLEND_S, END_S, FAULT_S, RECOVERY_S
from dftc_rt.config.calibration import Calibration

Gain = Literal["attributed", "always", "none"]
"""When a law's ρ̂ acts on its command: after an actuator loss was decided, always, never."""


@dataclass(frozen=True)
class Variant:
    """A law as it is compared.

    Attributes:
        law: ``control.law``.
        ftc: ``control.ftc``.
        title: For people.
        gain: When its ρ̂ acts.
        interconnections: Settings of ``control.interconnection`` that make a difference to it.
    """

    law: str
    ftc: bool
    title: str
    gain: Gain
    interconnections: tuple[str, ...] = ("desired",)


INTERCONNECTIONS: Final = ("desired", "measured", "frozen")
VARIANTS: Final = {
    "dftc": Variant("dftc", True, "dftc", "attributed", INTERCONNECTIONS),
    "dftc_gain_off": Variant("dftc", False, "dftc, gain off", "none"),
    "computed_torque": Variant("computed_torque", True, "B0 computed torque", "none"),
    "momentum": Variant("momentum", True, "B1 momentum observer", "always"),
    "eso": Variant("eso", True, "B2 extended-state observer", "none"),
    "adaptive": Variant("adaptive", True, "B3 direct adaptive", "always"),
    "oracle": Variant("oracle", True, "B4 true ρ", "none"),
}
"""Name -> law. The gain of B4 is the true ρ: it cannot act wrongly."""

KINDS: Final = {
    "loss20": "constant loss of 20 %",
    "loss40": "constant loss of 40 %",
    "loss70": "constant loss of 70 %",
    "ramp": "from 1 to 0.5 within 2 s",
    "sine": "0.75 + 0.25 cos(3 t)",
    "intermittent": "loss of 50 %, 0.5 s on, 0.5 s off",
    "total": "no torque at all",
    "two": "loss of 40 %, and of 30 % on the next loaded joint",
    "recovery": "loss of 40 % that ends after 3 s",
}
_TABLES: Final = {
    "loss20": 'kind="loss", effectiveness=0.8',
    "loss40": 'kind="loss", effectiveness=0.6',
    "loss70": 'kind="loss", effectiveness=0.3',
    "ramp": 'kind="ramp", to=0.5, over_s=2.0',
    "sine": 'kind="sine", mean=0.75, amplitude=0.25, omega_rad_s=3.0',
    "intermittent": 'kind="intermittent", effectiveness=0.5, period_s=1.0, duty=0.5',
    "total": 'kind="total"',
    "two": 'kind="loss", effectiveness=0.6',
    "recovery": f'kind="loss", effectiveness=0.6, end_s={RECOVERY_S}',
}
_SECOND: Final = 'kind="loss", effectiveness=0.7'


@dataclass(frozen=True)
class Group:
    """Runs that share a twin.

    Attributes:
        robot: Key of :data:`dftc_rt.benchmark.conditions.ROBOTS`.
        variant: Key of :data:`VARIANTS`.
        interconnection: ``control.interconnection``.
        momentum_threshold: Factor on the calibrated ``threshold_loss`` of ``momentum``; 1 for
            the other laws.
        draw: ``tuning`` or ``sealed``.
        seed: Of motion and noise.
    """

    robot: str
    variant: str
    interconnection: str
    momentum_threshold: float
    draw: str
    seed: int

    @property
    def id(self) -> str:
        """Stable name."""
        factor = f"*{self.momentum_threshold:g}" if self.variant == "momentum" else ""
        return "/".join(
            (self.robot, f"{self.variant}{factor}", self.interconnection, self.draw, f"{self.seed}")
        )

    def case_id(self, kind: str, joint: str) -> str:
        """Stable name of a case of the group."""
        return f"{self.id}/{kind}/{joint}"


def groups(
    robots: Sequence[str],
    variants: Sequence[str],
    interconnections: Sequence[str],
    momentum_threshold: float,
    draw: str,
    seeds: Sequence[int],
) -> list[Group]:
    """All groups, those of one seed together, so that a part of the grid is of every kind."""
    return [
        Group(
            robot, name, where, momentum_threshold if name == "momentum" else 1.0, draw, number
        )
        for number in seeds
        for robot in robots
        for name in variants
        for where in interconnections
        if where in VARIANTS[name].interconnections
    ]  # fmt: skip


def law_settings(group: Group, calibration: Calibration, path: str) -> list[str]:
    """Overrides of a scenario that choose law, calibration and seed.

    Args:
        group: Whose.
        calibration: Of the robot.
        path: Its file.
    """
    variant = VARIANTS[group.variant]
    found = [
        f'control.law="{variant.law}"',
        f"control.ftc={str(variant.ftc).lower()}",
        f'control.interconnection="{group.interconnection}"',
        f"control.calibration={quoted(path)}",
        f"seed={group.seed}",
        f"reference.seed={group.seed}",
    ]
    if group.variant == "momentum":
        values = [
            group.momentum_threshold * joint.gains["threshold_loss"] for joint in calibration.joint
        ]
        found.append(f"control.gains.threshold_loss={values}")
    return found


def run_settings() -> list[str]:
    """Overrides that every run with a fault, and its twin, has."""
    return [
        f"duration_s={END_S}", f"reference.blend_s={BLEND_S}", 'reference.kind="multisine"',
    ]  # fmt: skip


def fault_setting(kind: str, joint: str, second: str = "") -> str:
    """The override that puts a fault of a kind on a joint.

    Args:
        kind: Key of :data:`KINDS`.
        joint: Its joint.
        second: The other joint of kind ``two``.
    """
    tables = [f'{{joint="{joint}", start_s={FAULT_S}, {_TABLES[kind]}}}']
    if kind == "two":
        tables.append(f'{{joint="{second}", start_s={FAULT_S}, {_SECOND}}}')
    return f"fault=[{', '.join(tables)}]"


def partner(loaded: Sequence[str], joint: str) -> str | None:
    """The loaded joint after this one, the first after the last; None if there is no other."""
    after = loaded[(loaded.index(joint) + 1) % len(loaded)]
    return None if after == joint else after


def quoted(text: str) -> str:
    """A TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
