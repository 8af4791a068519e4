"""``dftc rig`` leaves the machine as it found it."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.integration.commands import DFTC, started

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize("there", [False, True], ids=["made", "found"])
def test_its_directory_goes_if_it_made_it(tmp_path: Path, there: bool) -> None:
    directory = tmp_path / "bus"
    if there:
        directory.mkdir(mode=0o700)
    command = (DFTC, "rig", "panda_shoulder_loss", "--lockstep", "--bus", "unix")
    with started(tmp_path / "run", *command, "--bus-dir", directory) as run:
        run.until_said("Ctrl-C ends")
        assert (directory / "can0").is_socket()
        run.process.send_signal(signal.SIGINT)
        assert run.end() == 0
    assert directory.exists() == there
    assert not there or list(directory.iterdir()) == []
