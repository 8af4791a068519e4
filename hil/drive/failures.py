"""Drives that fail as nodes: emergencies, silence, late answers, restarts.

Source: docs/faults.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dftc_rt.config import faults as kinds
from dftc_rt.config.faults import DriveFault, Fault
from dftc_rt.errors import InputError
from hil.drive.interface import EmulatedDrives
from hil.drive.node402 import Cia402Drives


@dataclass
class _Failure:
    drive: int
    fault: DriveFault
    active: bool = False


class DriveFailures:
    """Lets the drives fail when it is time."""

    def __init__(
        self, faults: Sequence[Fault], joints: Sequence[str], drives: EmulatedDrives
    ) -> None:
        """Take the faults of drives.

        Args:
            faults: The scenario's, checked by :func:`check_failures`; others are passed over.
            joints: Joint of each drive; the faults' joints are among them.
            drives: The drives.
        """
        self._drives = drives
        self._joints = joints
        self._failures: list[_Failure] = []
        self.change(faults)

    def change(self, faults: Sequence[Fault]) -> None:
        """Take other faults; what a kind does to a drive now goes on, and ends when it should."""
        active = {(each.drive, type(each.fault)) for each in self._failures if each.active}
        self._failures = []
        for fault in faults:
            if isinstance(fault, DriveFault):
                drive = self._joints.index(fault.joint)
                begun = (drive, type(fault)) in active
                active.discard((drive, type(fault)))
                self._failures.append(_Failure(drive, fault, begun))

    def apply(self, t: float) -> None:
        """Begin and end what is due at rig time ``t``, s, which does not run backwards."""
        for failure in self._failures:
            due = failure.fault.start_s <= t < failure.fault.end_s
            if due != failure.active:
                failure.active = due
                assert isinstance(self._drives, Cia402Drives)
                (_begin if due else _end)(failure.drive, failure.fault, self._drives)


def check_failures(faults: Sequence[Fault], profile: str) -> None:
    """Check that the drives of a profile can fail so.

    Raises:
        InputError: They cannot: emergencies, boot-up and NMT are CANopen's.
    """
    for k, fault in enumerate(faults):
        if isinstance(fault, DriveFault) and profile != "cia402":
            kind = type(fault).__struct_config__.tag
            found = f"'{kind}' with bus.profile '{profile}'"
            raise InputError(f"fault[{k}].kind", found, "the profile cia402, or another kind")


def _begin(drive: int, fault: DriveFault, drives: Cia402Drives) -> None:
    match fault:
        case kinds.EmcyFault():
            drives.fault(drive, fault.error_code, lasting=True)
        case kinds.SilentFault():
            drives.disconnect(drive, True)
        case kinds.LateFault():
            drives.delay(drive, fault.delay_s)
        case kinds.RestartFault():
            drives.switch_off(drive)


def _end(drive: int, fault: DriveFault, drives: Cia402Drives) -> None:
    match fault:
        case kinds.EmcyFault():
            drives.clear_cause(drive)
        case kinds.SilentFault():
            drives.disconnect(drive, False)
        case kinds.LateFault():
            drives.delay(drive, 0.0)
        case kinds.RestartFault():
            drives.switch_on(drive)
