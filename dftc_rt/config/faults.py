"""``[[fault]]`` of a scenario: what breaks, when, and how much. ``docs/faults.md`` is for users."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from dftc_rt.config.fields import Fraction, NonNegative, Positive, Strict

CanId = Annotated[int, Meta(ge=0, le=0x7FF)]


class _Timed(Strict, frozen=True, tag_field="kind", kw_only=True):
    start_s: NonNegative = 0.0
    end_s: Positive = 1e9


class _Fault(_Timed, frozen=True, kw_only=True):
    joint: str


class LossFault(_Fault, frozen=True, tag="loss", kw_only=True):
    """Constant partial loss: the motor delivers ``effectiveness`` of its torque."""

    effectiveness: Fraction


class RampFault(_Fault, frozen=True, tag="ramp", kw_only=True):
    """Incipient loss: effectiveness falls linearly from 1 to ``to`` in ``over_s``."""

    to: Fraction
    over_s: Positive


class SineFault(_Fault, frozen=True, tag="sine", kw_only=True):
    """Effectiveness ``mean + amplitude cos(omega t)``, t since the run began."""

    mean: Fraction
    amplitude: Fraction
    omega_rad_s: Positive


class IntermittentFault(_Fault, frozen=True, tag="intermittent", kw_only=True):
    """Loss that comes and goes: ``effectiveness`` for ``duty`` of each period."""

    effectiveness: Fraction
    period_s: Positive
    duty: Fraction = 0.5


class TotalFault(_Fault, frozen=True, tag="total", kw_only=True):
    """Total loss: no torque at all."""


class BiasFault(_Fault, frozen=True, tag="bias", kw_only=True):
    """The motor gives ``torque_nm`` on top of what it is told."""

    torque_nm: float


class SaturationFault(_Fault, frozen=True, tag="saturation", kw_only=True):
    """The motor gives at most ``limit`` of the joint's torque limit."""

    limit: Fraction


class DeadZoneFault(_Fault, frozen=True, tag="dead_zone", kw_only=True):
    """The first ``width_nm`` of torque, in either direction, are swallowed."""

    width_nm: Positive


class StuckTorqueFault(_Fault, frozen=True, tag="stuck_torque", kw_only=True):
    """The motor goes on giving what it gave when the fault began."""


class LagFault(_Fault, frozen=True, tag="lag", kw_only=True):
    """The motor's torque comes through a further first-order lag of ``lag_s``."""

    lag_s: Positive


class PayloadFault(_Timed, frozen=True, tag="payload", kw_only=True):
    """A point mass on the link behind ``joint``, by default the last: no actuator fault."""

    joint: str | None = None
    payload_kg: Positive
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.1)


class ContactFault(_Timed, frozen=True, tag="contact", kw_only=True):
    """A force, base frame, on the origin of the link behind ``joint``, by default the last."""

    joint: str | None = None
    force_n: tuple[float, float, float]


class FrictionFault(_Timed, frozen=True, tag="friction", kw_only=True):
    """Friction of ``joint``, by default of all, is ``factor`` times what it was."""

    joint: str | None = None
    factor: NonNegative


class LockFault(_Fault, frozen=True, tag="lock", kw_only=True):
    """The joint is blocked where it stands; its drive notices nothing."""


class EmcyFault(_Fault, frozen=True, tag="emcy", kw_only=True):
    """The drive goes into fault with this EMCY error code; the cause lasts until ``end_s``."""

    error_code: Annotated[int, Meta(ge=1, le=0xFFFF)]


class SilentFault(_Fault, frozen=True, tag="silent", kw_only=True):
    """The drive's node sends nothing and hears nothing."""


class LateFault(_Fault, frozen=True, tag="late", kw_only=True):
    """What the drive's node sends comes ``delay_s`` later."""

    delay_s: Positive


class RestartFault(Strict, frozen=True, tag_field="kind", tag="restart", kw_only=True):
    """The drive loses its supply and is back ``boot_s`` later, as after power-on."""

    joint: str
    start_s: NonNegative = 0.0
    boot_s: Positive = 0.5

    @property
    def end_s(self) -> float:
        """When the drive is back, s."""
        return self.start_s + self.boot_s


DriveFault = EmcyFault | SilentFault | LateFault | RestartFault


class SensorBiasFault(_Fault, frozen=True, tag="sensor_bias", kw_only=True):
    """The encoder reads ``bias_rad`` too much."""

    bias_rad: Annotated[float, Meta(ge=-1e4, le=1e4)]


class SensorFrozenFault(_Fault, frozen=True, tag="sensor_frozen", kw_only=True):
    """The encoder stands still: the position stays, and the velocity made of it is 0."""


class SensorNoiseFault(_Fault, frozen=True, tag="sensor_noise", kw_only=True):
    """White noise on position and velocity, standard deviations, besides the drive's own."""

    position_rad: Annotated[float, Meta(ge=0, le=1e4)] = 0.0
    velocity_rad_s: Annotated[float, Meta(ge=0, le=1e4)] = 0.0


class SensorBitsFault(_Fault, frozen=True, tag="sensor_bits", kw_only=True):
    """The encoder's ``bits`` lowest bits read 0."""

    bits: Annotated[int, Meta(ge=1, le=31)]


SensorFault = SensorBiasFault | SensorFrozenFault | SensorNoiseFault | SensorBitsFault


class OnBus(_Timed, frozen=True, kw_only=True):
    """A fault of the bus ``bus``, by its logical name; the others are faults of the robot."""

    bus: str


class _FrameFault(OnBus, frozen=True, kw_only=True):
    can_id: CanId | None = None


class FrameLossFault(_FrameFault, frozen=True, tag="frame_loss", kw_only=True):
    """Frames vanish, and their senders do not know."""

    probability: Fraction


class FrameCorruptionFault(_FrameFault, frozen=True, tag="frame_corruption", kw_only=True):
    """Frames fail their CRC: nobody takes them, and their senders repeat them or do not."""

    probability: Annotated[float, Meta(ge=0, lt=1)]
    retransmit: bool = True


class FrameDelayFault(_FrameFault, frozen=True, tag="frame_delay", kw_only=True):
    """Frames come later than they were sent."""

    delay_s: Positive
    probability: Fraction = 1.0


class FrameDuplicationFault(_FrameFault, frozen=True, tag="frame_duplication", kw_only=True):
    """Frames come twice, as after an error in the last bit of the end of a frame."""

    probability: Fraction


class BabbleFault(OnBus, frozen=True, tag="babble", kw_only=True):
    """A node that sends without a pause."""

    can_id: CanId
    rate_hz: Annotated[float, Meta(gt=0, le=20_000)]
    data_bytes: Annotated[int, Meta(ge=0, le=8)] = 8


class BusOffFault(OnBus, frozen=True, tag="bus_off", kw_only=True):
    """A CAN node is off the bus: what it sends and should hear is lost.

    That of the drive of ``joint``, by default the controller's.
    """

    joint: str | None = None


BusFault = (
    FrameLossFault
    | FrameCorruptionFault
    | FrameDelayFault
    | FrameDuplicationFault
    | BabbleFault
    | BusOffFault
)

RobotFault = (
    LossFault
    | RampFault
    | SineFault
    | IntermittentFault
    | TotalFault
    | BiasFault
    | SaturationFault
    | DeadZoneFault
    | StuckTorqueFault
    | LagFault
    | PayloadFault
    | ContactFault
    | FrictionFault
    | LockFault
    | DriveFault
    | SensorFault
)
"""Faults of joints, arm, drives and sensors: all but those of a bus."""

Fault = RobotFault | BusFault
