"""What is frozen before the sealed draw is run, and the threshold at which B1 is compared."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import msgspec
import tomli_w

from dftc_rt.benchmark.sources import digest
from dftc_rt.config import toml
from dftc_rt.errors import InputError, MissingFileError

FROZEN: Final = "frozen.toml"


class Frozen(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``frozen.toml``.

    Attributes:
        when: Time of freezing, UTC.
        settings: Hash of everything below but the time.
        momentum_threshold: Least factor on the calibrated ``threshold_loss`` of the law
            ``momentum`` at which it gives no more false alarms than ``dftc``.
        dftc_alarms: False alarms of ``dftc`` on the tuning draw.
        dftc_hours: In so many simulated hours.
        momentum_alarms: The same of ``momentum`` at that factor.
        momentum_hours: The same.
        fingerprints: Robot -> hash of sources and calibration.
    """

    when: str
    settings: str = ""
    momentum_threshold: float
    dftc_alarms: int
    dftc_hours: float
    momentum_alarms: int
    momentum_hours: float
    fingerprints: dict[str, str]


def stamped(found: Frozen) -> Frozen:
    """The same with its hash."""
    plain = {k: v for k, v in msgspec.to_builtins(found).items() if k not in ("when", "settings")}
    return msgspec.structs.replace(
        found, settings=digest([("frozen", msgspec.json.encode(plain, order="sorted"))])
    )


def write(found: Frozen, path: Path) -> None:
    """Write the file.

    Raises:
        InputError: It cannot be written.
    """
    head = "# Written by `dftc benchmark faults --freeze`; the sealed draw is run with this.\n"
    try:
        path.write_text(head + tomli_w.dumps(msgspec.to_builtins(found)), encoding="utf-8")
    except OSError as error:
        raise InputError(str(path), f"cannot be written: {error.strerror}") from None


def load(path: Path) -> Frozen:
    """Read the file.

    Raises:
        MissingFileError: Nothing has been frozen.
        InputError: It is no such file, or was changed by hand.
    """
    if not path.exists():
        raise MissingFileError(
            str(path), "nothing is frozen yet", "dftc benchmark faults --draw tuning --freeze"
        )
    found = toml.load(path, Frozen)
    if stamped(found).settings != found.settings:
        raise InputError(f"{path}: settings", "is not the hash of the rest", "the file as written")
    return found


def check(found: Frozen, marks: Mapping[str, str], where: str) -> None:
    """Refuse sources or calibrations that are not those that were frozen.

    Raises:
        InputError: A robot's differ.
    """
    for robot, mark in marks.items():
        frozen = found.fingerprints.get(robot, "nothing")
        if frozen != mark:
            raise InputError(
                f"{where}: {robot}", f"frozen with {frozen}, now {mark}",
                "the sources and calibrations that were frozen",
            )  # fmt: skip
