"""What may be asked of a log."""

from __future__ import annotations

import pytest

from dftc_rt.errors import InputError
from dftc_rt.replay.keys import check_settings, sets


def test_what_thinks_may_be_asked() -> None:
    check_settings([])
    check_settings(["control.gains.threshold_loss=3", "control.law=momentum", "control.ftc=false"])
    check_settings([" supervisor.rho_min = 0.3", "control.calibration=panda.toml"])


@pytest.mark.parametrize(
    "setting",
    [
        "robot.name=ur5", "reference.seed=8", "executor.rate_hz=500", "duration_s=3",
        "bus.profile=mit", "rig.plant.payload_kg=1", "fault=[]", "seed=2", 'control={law="eso"}',
        "supervisor.stop_ramp_s=1", "controls.law=eso", "name=other",
    ],
)  # fmt: skip
def test_what_moved_may_not(setting: str) -> None:
    with pytest.raises(InputError, match="cannot be asked of a log") as error:
        check_settings(["control.ftc=false", setting])
    assert setting in str(error.value)
    assert error.value.exit_code == 2


def test_a_key_is_the_whole_key() -> None:
    given = ["control.calibration =a.toml"]
    assert sets(given, "control.calibration")
    assert not sets(given, "control.calib")
    assert not sets(given, "control.identification")
