"""The moteus protocol as a drive profile."""

from __future__ import annotations

from typing import Final

from dftc_rt.drives.interface import Profile
from dftc_rt.drives.moteus.client import MoteusClient
from dftc_rt.drives.moteus.cycle import MoteusCycle

PROFILE: Final = Profile("moteus", MoteusClient, MoteusCycle, fd=True)
