"""CiA 402 as a drive profile."""

from __future__ import annotations

from typing import Final

from dftc_rt.drives.cia402.client import Cia402Client
from dftc_rt.drives.cia402.cycle import Cia402Cycle
from dftc_rt.drives.interface import Profile

PROFILE: Final = Profile("cia402", Cia402Client, Cia402Cycle)
