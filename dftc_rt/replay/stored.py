"""What a log holds of the controller that wrote it, and that controller made of it again.

The resolved scenario and the URDF are not all that a controller is made of. The files that the
scenario names may have changed or be elsewhere when the log is replayed, so they are attached.
"""

from __future__ import annotations

import tempfile
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from dftc_rt.config import toml
from dftc_rt.config.calibration import Calibration, load_calibration
from dftc_rt.config.identification import load_identification
from dftc_rt.config.load import from_raw
from dftc_rt.config.robot import RobotConfig
from dftc_rt.config.scenario import Scenario
from dftc_rt.controller import Parts, prepare, scenario_robot
from dftc_rt.dynamics.model import Robot
from dftc_rt.errors import InputError, LogError
from dftc_rt.log.run import Run
from dftc_rt.replay.keys import check_settings, sets

F64 = NDArray[np.float64]

ROBOT: Final = "robot.toml"
CALIBRATION: Final = "calibration.toml"
IDENTIFICATION: Final = "identification.npz"
REFERENCE: Final = "reference.csv"
_KEYS: Final = {
    CALIBRATION: "control.calibration",
    IDENTIFICATION: "control.identification",
    REFERENCE: "reference.file",
}
_HERE: Final = "a log of this version of dftc"


@dataclass(frozen=True)
class Stored:
    """A controller out of a log.

    Attributes:
        scenario: The log's, with what was overridden.
        text: The same as TOML.
        robot: The nominal robot.
        parts: Law, reference, local terms, scales.
        files: As :func:`files_of` gives them, for a log of the replay.
        units: Torque that a logged command means to this controller over what it meant to the
            one that logged it, (n,): 1 but where another calibration has other torque constants.
    """

    scenario: Scenario
    text: str
    robot: Robot
    parts: Parts
    files: dict[str, bytes]
    units: F64


def files_of(scenario: Scenario, robot: Robot) -> dict[str, bytes]:
    """Name -> content of what the controller is made of besides scenario and URDF.

    Args:
        scenario: The resolved scenario.
        robot: Its robot.

    Raises:
        InputError: A file has gone since it was loaded.
    """
    files = {ROBOT: toml.dumps(robot.config).encode()}
    return files | {name: _content(path) for name, path in _named(scenario).items()}


def _named(scenario: Scenario) -> dict[str, str]:
    """Attachment -> path, of the files that a scenario names."""
    control, reference = scenario.control, scenario.reference
    paths = {
        CALIBRATION: control.calibration,
        IDENTIFICATION: control.identification,
        REFERENCE: reference.file if reference.kind == "csv" else None,
    }
    return {name: path for name, path in paths.items() if path is not None}


def _content(path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}", "a file") from None


def controller_of(run: Run, settings: Sequence[str] = (), where: str = "the log") -> Stored:
    """Make the controller of a log again.

    Args:
        run: The log.
        settings: Overrides, ``a.b=value``; files that they name are read from disk.
        where: The log's name, for messages.

    Raises:
        LogError: The log lacks something, or was written by another version.
        InputError: A setting is wrong, or cannot be asked of a log.
    """
    check_settings(settings)
    config, raw = _stored(run, where)
    loaded = from_raw(toml.apply_overrides(raw, settings), "--set")
    scenario = loaded.scenario
    if ":" in scenario.control.law and not sets(settings, "control.law"):
        what = f"its law {scenario.control.law} is code, which no log may load"
        raise LogError(where, what, f"--set control.law={scenario.control.law}, if you trust it")
    robot = scenario_robot(scenario, (config, run.urdf))
    named = _named(scenario)
    files = {ROBOT: toml.dumps(config).encode()}
    attached = {}
    with tempfile.TemporaryDirectory(prefix="dftc-") as folder:
        for name, path in named.items():
            if sets(settings, _KEYS[name]):
                files[name] = _content(path)
            else:
                files[name] = _attachment(run, name, where)
                attached[name] = Path(folder) / name
                attached[name].write_bytes(files[name])
        calibration, identification = attached.get(CALIBRATION), attached.get(IDENTIFICATION)
        parts = prepare(
            _with_reference(scenario, attached.get(REFERENCE)),
            robot,
            None if calibration is None else load_calibration(calibration),
            None if identification is None else load_identification(identification),
        )
    units = np.ones(robot.n)
    if sets(settings, _KEYS[CALIBRATION]):
        units = np.array(parts.robot.torque_constant) / _constants(run, raw, robot.n, where)
    return Stored(scenario, loaded.text, robot, parts, files, units)


def robot_of(run: Run, where: str = "the log") -> Robot:
    """Make the robot of a log again.

    Args:
        run: The log.
        where: The log's name, for messages.

    Raises:
        LogError: The log lacks something, or was written by another version.
        InputError: Its URDF is refused.
    """
    config, raw = _stored(run, where)
    return scenario_robot(from_raw(raw, "scenario.toml").scenario, (config, run.urdf))


def _stored(run: Run, where: str) -> tuple[RobotConfig, dict[str, Any]]:
    """What a log holds of its robot, and its scenario as a checked dictionary."""
    config = _robot_config(run, where)
    try:
        raw = tomllib.loads(run.scenario)
        from_raw(raw, "scenario.toml")  # so that what is wrong later is an override
    except (InputError, tomllib.TOMLDecodeError) as error:
        raise LogError(where, f"attachment {' '.join(str(error).split())}", _HERE) from None
    return config, raw


def _constants(run: Run, raw: dict[str, Any], n: int, where: str) -> F64:
    """Torque constants that the log was written with, (n,)."""
    if "calibration" not in raw.get("control", {}):
        return np.ones(n)
    text = _attachment(run, CALIBRATION, where).decode()
    found = toml.convert(tomllib.loads(text), Calibration, f"{where}: {CALIBRATION}")
    return np.array([joint.torque_constant for joint in found.joint])


def _with_reference(scenario: Scenario, path: Path | None) -> Scenario:
    """The scenario with the attached motion in place of the file that it names."""
    if path is None:
        return scenario
    replace = msgspec.structs.replace
    return replace(scenario, reference=replace(scenario.reference, file=str(path)))


def _robot_config(run: Run, where: str) -> RobotConfig:
    if not (run.scenario and run.urdf):
        missing = "scenario.toml" if not run.scenario else "robot.urdf"
        raise LogError(where, f"no attachment {missing}", _HERE)
    try:
        text = _attachment(run, ROBOT, where).decode()
        return toml.convert(tomllib.loads(text), RobotConfig, ROBOT)
    except LogError:
        raise
    except (InputError, ValueError) as error:
        raise LogError(where, f"attachment {' '.join(str(error).split())}", _HERE) from None


def _attachment(run: Run, name: str, where: str) -> bytes:
    if name not in run.attachments:
        raise LogError(where, f"no attachment {name}", _HERE)
    return run.attachments[name]
