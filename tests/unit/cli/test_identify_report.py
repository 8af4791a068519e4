"""What is said of networks that help, that do harm, and that learned nothing."""

import msgspec
import pytest

from dftc_rt.cli.identify_report import JointReport, Report, warnings

GOOD = JointReport(
    name="a", cells=(3, 45), position_percent=20.0, velocity_percent=30.0, ridge=1e-3,
    gain_network=False, training_percent=(1.0, 0.5), held_out_percent=(1.0, 0.6),
    rho_rmse=(0.02, 0.01), false_alarms=(1, 0),
)  # fmt: skip


def _warned(**changed: object) -> list[str]:
    joint = msgspec.structs.replace(GOOD, **changed)
    report = Report(
        robot="x", source="", calibration="", grid=(5, 9), training_s=60.0, held_out_s=30.0,
        joint=(msgspec.structs.replace(GOOD, name="b"), joint),
    )  # fmt: skip
    return warnings(report)


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"held_out_percent": (0.5, 0.6)}, "a: worse on motion it was not trained on: 0.500 → "),
        ({"rho_rmse": (0.01, 0.02)}, "a: ρ̂ further off on motion it was not trained on: 0.010"),
        ({"false_alarms": (0, 2)}, "a: more false alarms on motion it was not trained on: 0 → 2"),
        ({"ridge": None}, "a: learned nothing that transfers; networks 0"),
    ],
)
def test_what_got_worse_is_said_of_the_joint(changed: dict[str, object], expected: str) -> None:
    (line,) = _warned(**changed)
    assert line.startswith(expected)


def test_what_helps_needs_no_warning() -> None:
    assert _warned() == []
