"""A scenario from a file, with overrides; and back to TOML, with every default written out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dftc_rt.config import toml
from dftc_rt.config.robot import one_robot
from dftc_rt.config.scenario import Scenario
from dftc_rt.errors import InputError, MissingFileError


@dataclass(frozen=True)
class LoadedScenario:
    """A scenario, checked.

    Attributes:
        scenario: The values.
        text: The same as TOML, resolved: overrides applied, defaults written out.
    """

    scenario: Scenario
    text: str


def load_scenario(
    source: str | Path, settings: Sequence[str] = (), shipped: Path | None = None
) -> LoadedScenario:
    """Load a scenario.

    Args:
        source: Path of a TOML file, or the bare name of a shipped scenario.
        settings: Overrides, ``a.b=value``.
        shipped: Folder in which bare names are looked up.

    Raises:
        InputError: The file or an override is wrong; one line says where.
    """
    try:
        path = _find(source, shipped)
        raw = toml.apply_overrides(toml.read(path), settings)
        _resolve_paths(raw, path.parent)
        return from_raw(raw, str(path))
    except RecursionError:
        raise InputError(
            str(source), "nested too deeply", "tables as in docs/contract.md"
        ) from None
    except InputError:  # among them MissingFileError, which is an OSError too
        raise
    except OSError as error:
        reason = error.strerror or "cannot be read"
        raise InputError(f"{str(source)[:80]}", reason, "the path of a TOML file") from None


def from_raw(raw: dict[str, Any], where: str) -> LoadedScenario:
    """Check a scenario given as nested dictionaries.

    Raises:
        InputError: A key or value is wrong.
    """
    _refuse_infinite(raw, where)
    scenario = toml.convert(raw, Scenario, where)
    watchdog_s, rate_hz = scenario.rig.drive.watchdog_s, scenario.executor.rate_hz
    if watchdog_s * rate_hz < 2.0 * (1 - 1e-9):
        raise InputError(
            f"{where}: rig.drive.watchdog_s",
            f"{watchdog_s:g} s is less than two periods at {rate_hz:g} Hz",
            f"at least {2.0 / rate_hz:g}",
        )
    one_robot(scenario.robot.name, scenario.robot.urdf, scenario.robot.plant, f"{where}: robot")
    for k, fault in enumerate(scenario.fault):
        if fault.end_s <= fault.start_s:
            raise InputError(
                f"{where}: fault[{k}].end_s", f"{fault.end_s}", f"more than start_s {fault.start_s}"
            )
    return LoadedScenario(scenario, toml.dumps(scenario))


def from_text(text: str) -> Scenario:
    """Read a resolved scenario back.

    Raises:
        InputError: It is not what :func:`load_scenario` wrote.
    """
    import tomllib

    return from_raw(tomllib.loads(text), "resolved scenario").scenario


def _refuse_infinite(node: Any, where: str, path: str = "") -> None:
    """Refuse an infinite number anywhere: nothing here may be one, and ranges let it pass."""
    if isinstance(node, dict):
        for key, value in node.items():
            _refuse_infinite(value, where, f"{path}.{key}" if path else str(key))
    elif isinstance(node, (list, tuple)):
        for index, value in enumerate(node):
            _refuse_infinite(value, where, f"{path}[{index}]")
    elif isinstance(node, float) and math.isinf(node):
        raise InputError(f"{where}: {path}", f"found {node}", "a finite number")


def _find(source: str | Path, shipped: Path | None) -> Path:
    path = Path(source)
    if path.exists() or shipped is None:
        return path
    if path.name == str(source) and not path.suffix:
        named = shipped / f"{source}.toml"
        if named.is_file():
            return named
        known = ", ".join(sorted(p.stem for p in shipped.glob("*.toml")))
        raise MissingFileError(str(source), "no such file", f"a file, or one of {known}")
    return path


def _resolve_paths(raw: dict[str, Any], folder: Path) -> None:
    """Take paths in the file relative to the file, where such a file exists."""
    for table, key in (
        ("robot", "urdf"),
        ("reference", "file"),
        ("control", "calibration"),
        ("control", "identification"),
    ):
        section = raw.get(table)
        value = section.get(key) if isinstance(section, dict) else None
        if isinstance(value, str) and (folder / value).is_file():
            section[key] = str((folder / value).resolve())  # type: ignore[index]
