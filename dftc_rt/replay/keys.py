"""Which keys of a scenario can be asked of a log: what thinks, not what moved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from dftc_rt.errors import InputError

_TABLES: Final = ("control.", "supervisor.")
_MOTION: Final = "supervisor.stop_ramp_s"
_EXPECTED: Final = (
    "a key of control or of supervisor but for stop_ramp_s; robot, motion, rate, buses and faults "
    "are what was logged"
)


def check_settings(settings: Sequence[str]) -> None:
    """Refuse an override of what the logged feedback depends on.

    Args:
        settings: Overrides, ``a.b=value``.

    Raises:
        InputError: One of them is no such key.
    """
    for setting in settings:
        key = _key(setting)
        if not key.startswith(_TABLES) or key == _MOTION:
            raise InputError(f"--set {setting}", "cannot be asked of a log", _EXPECTED)


def sets(settings: Sequence[str], key: str) -> bool:
    """Whether one of the settings is of this key."""
    return any(_key(setting) == key for setting in settings)


def _key(setting: str) -> str:
    return setting.partition("=")[0].strip()
