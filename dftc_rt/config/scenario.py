"""The scenario file: one run, from robot to faults, as frozen typed structures.

Every key is checked: an unknown key, a wrong type or a value out of range is refused
with its path. ``docs/contract.md`` describes each key for users.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, field

from dftc_rt.config.faults import Fault
from dftc_rt.config.fields import (
    AtLeastOne,
    Deflection,
    Magnitudes,
    NonNegative,
    Positive,
    Positives,
    Scalars,
    Seed,
    Strict,
)
from dftc_rt.config.robot import Plant


class RobotTable(Strict, frozen=True):
    """``[robot]``: which robot; one of ``name``, ``urdf`` and ``plant``."""

    name: str | None = None
    urdf: str | None = None
    plant: Plant | None = None
    lock: tuple[str, ...] = ()
    home_rad: tuple[float, ...] | None = None
    joints_per_bus: Annotated[int, Meta(ge=1)] | None = None


class ReferenceTable(Strict, frozen=True):
    """``[reference]``: desired motion about the home pose."""

    kind: Literal["hold", "sine", "multisine", "waypoints", "csv", "paper1", "paper2"] = "multisine"
    amplitude_rad: Scalars = 0.35
    # One number, or [lowest, highest]. Not tuple[Positive, Positive]: msgspec 0.22 reads
    # freed memory on a bounded number in union with a tuple of fixed length.
    frequency_hz: Positive | tuple[Positive, ...] = (0.1, 0.5)
    sines: Annotated[int, Meta(ge=1, le=64)] = 4
    seed: Seed = 7
    blend_s: NonNegative = 1.0
    times_s: tuple[float, ...] = ()
    positions_rad: tuple[tuple[float, ...], ...] = ()
    file: str | None = None


class ControlTable(Strict, frozen=True):
    """``[control]``: which law, and its settings."""

    law: str = "dftc"
    ftc: bool = True
    interconnection: Literal["frozen", "desired", "measured"] = "desired"
    local_terms: Literal["exact", "tabulated"] = "exact"
    calibration: str | None = None
    identification: str | None = None
    identification_in_law: bool = False
    gains: dict[str, Any] = field(default_factory=dict)


class ExecutorTable(Strict, frozen=True):
    """``[executor]``: the fixed-rate loop."""

    rate_hz: Annotated[float, Meta(ge=10, le=10_000)] = 1000.0
    overrun: Literal["skip", "catch_up", "stop"] = "skip"
    read_budget: Literal["auto"] | Annotated[float, Meta(gt=0, le=1)] = "auto"


class MitTable(Strict, frozen=True):
    """``[bus.mit]``: MIT drives on the wire; a range left out follows from the limits."""

    p_max_rad: Positives | None = None
    v_max_rad_s: Positives | None = None
    t_max_nm: Positives | None = None
    kp_max: Positives = 500.0
    kd_max: Positives = 5.0
    position_wraps: bool = False
    host_id: Annotated[int, Meta(ge=0, le=0x7FF)] = 0
    answer_bytes: Literal[6, 8] = 6


class MoteusTable(Strict, frozen=True):
    """``[bus.moteus]``: how moteus drives are commanded."""

    host_id: Annotated[int, Meta(ge=0, le=127)] = 0
    watchdog_s: Annotated[float, Meta(ge=0, le=1.27)] = 0.0


class BusTable(Strict, frozen=True):
    """``[bus]``: how frames travel."""

    interface: Literal["auto", "vcan", "unix", "inprocess"] = "auto"
    timing: Literal["off", "account", "pace"] = "account"
    overload: Literal["refuse", "allow"] = "refuse"
    profile: Literal["cia402", "mit", "moteus"] = "cia402"
    bitrate: Annotated[int, Meta(ge=10_000, le=1_000_000)] = 1_000_000
    data_bitrate: Annotated[int, Meta(ge=10_000, le=8_000_000)] = 5_000_000
    mit: MitTable = MitTable()
    moteus: MoteusTable = MoteusTable()


class SupervisorTable(Strict, frozen=True):
    """``[supervisor]``: limits that end in a safe stop."""

    tracking_error_rad: Positive = 0.5
    stale_cycles: Annotated[int, Meta(ge=1)] = 20
    rho_min: Annotated[float, Meta(gt=0, lt=1)] = 0.15
    saturation_s: Positive = 1.0
    stop_ramp_s: Annotated[float, Meta(gt=0, le=60)] = 0.3
    position_margin_rad: NonNegative = 0.05
    velocity_factor: Positive = 2.0
    torque_rate_per_s: Positive = 500.0
    overruns_in_a_row: Annotated[int, Meta(ge=1)] = 20
    brake_s: Annotated[float, Meta(ge=0, le=0.9)] = 0.03
    probe: Annotated[float, Meta(ge=0, le=0.2)] = 0.0


class PlantTable(Strict, frozen=True):
    """``[rig.plant]``: the true robot; the controller is not told."""

    substeps: Annotated[int, Meta(ge=1, le=1000)] = 4
    q0_rad: tuple[float, ...] | None = None
    v0_rad_s: tuple[float, ...] | None = None
    payload_kg: NonNegative = 0.0
    payload_com_m: tuple[float, float, float] = (0.0, 0.0, 0.1)
    viscous: Magnitudes = 0.0
    coulomb: Magnitudes = 0.0
    viscous_fraction: Magnitudes = 0.0
    coulomb_fraction: Magnitudes = 0.0
    friction: Literal["coulomb", "lugre"] = "coulomb"
    stribeck: AtLeastOne | tuple[AtLeastOne, ...] = 1.3
    stribeck_rad_s: Positives = 0.05
    presliding_rad: Deflection | tuple[Deflection, ...] = 2e-4
    load_friction: Magnitudes = 0.3
    torque_constant: Positives = 1.0
    armature: Magnitudes | None = None


class DriveTable(Strict, frozen=True):
    """``[rig.drive]``: the emulated drives."""

    encoder_bits: Annotated[int, Meta(ge=4, le=31)] = 19
    velocity_noise_rad_s: NonNegative = 0.002
    torque_lag_s: NonNegative = 0.001
    watchdog_s: Annotated[float, Meta(gt=0, le=3600)] = 0.02
    brake_close_s: NonNegative = 0.02


class RigTable(Strict, frozen=True):
    """``[rig]``: the robot's stand-in."""

    plant: PlantTable = PlantTable()
    drive: DriveTable = DriveTable()


class Scenario(Strict, frozen=True):
    """One run. See the module's docstring."""

    name: Annotated[str, Meta(pattern=r"^[A-Za-z0-9._-]+$")]
    robot: RobotTable
    seed: Seed = 1
    duration_s: Annotated[float, Meta(gt=0, le=86_400)] = 20.0
    reference: ReferenceTable = ReferenceTable()
    control: ControlTable = ControlTable()
    executor: ExecutorTable = ExecutorTable()
    bus: BusTable = BusTable()
    supervisor: SupervisorTable = SupervisorTable()
    rig: RigTable = RigTable()
    fault: tuple[Fault, ...] = ()
