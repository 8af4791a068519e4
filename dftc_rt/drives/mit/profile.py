"""The MIT protocol as a drive profile."""

from __future__ import annotations

from typing import Final

from dftc_rt.drives.interface import Profile
from dftc_rt.drives.mit.client import MitClient
from dftc_rt.drives.mit.cycle import MitCycle

PROFILE: Final = Profile("mit", MitClient, MitCycle)
