"""The files that a user gives, each with the reader that its commands call and damage for it."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import io
import re
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any
from unittest import mock

import msgspec
import numpy as np
import tomli_w
from hypothesis import strategies as st

from dftc_rt.cli.analyze import analyze
from dftc_rt.cli.export import export
from dftc_rt.cli.recover import recover
from dftc_rt.cli.replay import replay
from dftc_rt.cli.report import report
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation, simulate
from dftc_rt.config import robot as robot_config
from dftc_rt.config.load import load_scenario
from dftc_rt.drives.cia402 import eds
from dftc_rt.drives.cia402.objects import EDS_PATH
from dftc_rt.errors import DftcError, EnvironmentLacksError, InputError
from tests.fuzz.damage import Draw, altered, damaged
from tests.fuzz.limits import HangsError, bounded, one_line
from tests.fuzz.log_damage import reseal

__all__ = ["HangsError", "Kind", "every_kind", "survive"]

SCENARIO = """
name = "fuzz"
duration_s = 0.02
robot = { plant = "arm2" }
[reference]
kind = "sine"
amplitude_rad = 0.2
frequency_hz = 0.3
blend_s = 0.01
[control.gains]
lam = 10.0
k = [10.0, 12.0]
[supervisor]
stop_ramp_s = 0.01
[bus.mit]
p_max_rad = 12.5
v_max_rad_s = [25.0, 25.0]
[rig.plant]
q0_rad = [0.0, 0.1]
viscous = [0.1, 0.2]
[[fault]]
kind = "loss"
joint = "joint1"
start_s = 0.01
effectiveness = 0.5
"""


def write(path: Path, content: bytes) -> Path:
    """Write a file and return its path."""
    path.write_bytes(content)
    return path


def toml_bytes(table: dict[str, Any]) -> bytes:
    """The table as TOML; what TOML cannot say becomes what is no TOML."""
    try:
        return tomli_w.dumps(table).encode("utf-8", "surrogatepass")
    except (TypeError, ValueError, UnicodeEncodeError):
        return repr(table).encode("utf-8", "surrogatepass")


@cache
def scenario_table() -> dict[str, Any]:
    """A scenario with every key written out."""
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder) / "s.toml", SCENARIO.encode())
        return tomllib.loads(load_scenario(path).text)


def try_scenario(content: bytes) -> bool:
    """Load a scenario as every command does, and run it for a moment; return whether it ran."""
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder) / "s.toml", content)
        opened = open_session(path)
        run_moment(opened)
    return True


def run_moment(opened: Any) -> None:
    """Run 20 cycles of a session that has been accepted."""
    scenario = opened.scenario
    replace = msgspec.structs.replace
    brief = replace(
        scenario,
        duration_s=20.0 / scenario.executor.rate_hz,
        supervisor=replace(scenario.supervisor, stop_ramp_s=0.01, brake_s=0.0),
        bus=replace(scenario.bus, timing="off"),
    )
    run, _ = run_simulation(dataclasses.replace(opened, scenario=brief), progress=False)
    torque = run.cycle["tau_cmd"]
    assert np.all(np.isfinite(torque)), "a torque that is not finite"
    assert np.all(np.abs(torque) <= opened.parts.torque_limit + 1e-9), "more than the limit"


def copy_of(table: dict[str, Any]) -> Any:
    """A copy that may be changed."""
    return copy.deepcopy(table)


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Attributes:
        name: For people.
        content: Draws bad ones.
        take: Reads one, as a command does.
        whole: Makes a good one.
    """

    name: str
    content: Any
    take: Callable[[bytes], bool]
    whole: Callable[[], bytes]


def scenarios() -> Kind:
    table = scenario_table()
    content = altered(table).map(toml_bytes) | damaged(toml_bytes(table))
    return Kind("scenario", content, try_scenario, lambda: toml_bytes(table))


URDF = """<?xml version="1.0"?>
<robot name="two">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.15" rpy="0 0 0"/><mass value="4.0"/>
    <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.002"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 0.15"/><mass value="3.0"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.002"/></inertial></link>
  <link name="hand"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="80" velocity="8"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 0.3" rpy="0 0 0.1"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="40" velocity="8"/><dynamics damping="0.1" friction="0.1"/>
  </joint>
  <joint name="grip" type="fixed"><parent link="lower"/><child link="hand"/></joint>
</robot>
"""
_URDF_WORDS = re.compile(r'"[^"]*"')
_URDF_VALUES = (
    "0", "-1", "1e300", "-1e300", "nan", "inf", "1e-320", "", "x", "0 0", "0 0 0", "1e300 0 0",
    "nan nan nan", "0 0 0 0", "base", "upper", "lower", "hand", "shoulder", "elbow", "floating",
    "planar", "continuous", "prismatic", "fixed", "revolute", "\u00e4", "x" * 3000, "&amp;", "-0",
)  # fmt: skip
_URDF_PIECES = (
    "<link/>", "<joint/>", "<joint name='e'/>", "<mimic joint='shoulder'/>", "<link name='upper'/>",
    "<joint name='loop' type='revolute'><parent link='lower'/><child link='upper'/>"
    "<axis xyz='0 1 0'/></joint>",
    "<joint name='self' type='fixed'><parent link='hand'/><child link='hand'/></joint>",
    "<!DOCTYPE robot [<!ENTITY a 'x'>]>", "&a;", "<!--", "<![CDATA[", "<inertial/>", "<limit/>",
    "<xacro:macro/>", "<transmission/>", "<a>" * 2000,
)  # fmt: skip


@st.composite
def altered_urdf(draw: Draw) -> bytes:
    """The URDF with values replaced and elements put in, taken out or doubled."""
    text = URDF
    for _ in range(draw(st.integers(1, 3))):
        how = draw(st.integers(0, 5))
        if how <= 3:
            places = list(_URDF_WORDS.finditer(text))
            if places:
                at = draw(st.sampled_from(places))
                value = draw(st.sampled_from(_URDF_VALUES) | st.floats().map(str))
                text = f'{text[: at.start()]}"{value}"{text[at.end() :]}'
        elif how == 4:
            at = draw(st.sampled_from([m.start() for m in re.finditer("<", text)] or [0]))
            text = text[:at] + draw(st.sampled_from(_URDF_PIECES)) + text[at:]
        else:
            elements = list(re.finditer(r"<[^>]*/>|<(link|joint).*?</\1>", text, re.DOTALL))
            if elements:
                at = draw(st.sampled_from(elements))
                text = text[: at.start()] + at[0] * draw(st.sampled_from((0, 2))) + text[at.end() :]
    return text.encode()


LAUGHS = (
    b'<!DOCTYPE robot [<!ENTITY a0 "ha">'
    + b"".join(b'<!ENTITY a%d "%s">' % (i, b"&a%d;" % (i - 1) * 10) for i in range(1, 12))
    + b']><robot name="&a11;"/>'
)
OUTSIDE = b'<!DOCTYPE robot [<!ENTITY e SYSTEM "file:///etc/passwd">]><robot name="x">&e;</robot>'


def try_urdf(content: bytes) -> bool:
    """Take it for a robot, as a scenario with ``robot.urdf`` does."""
    with tempfile.TemporaryDirectory() as folder:
        urdf = write(Path(folder) / "two.urdf", content)
        table = {
            "name": "fuzz", "robot": {"urdf": str(urdf)}, "duration_s": 0.02,
            "reference": {"kind": "hold"}, "control": {"law": "computed_torque"},
        }  # fmt: skip
        run_moment(open_session(write(Path(folder) / "s.toml", toml_bytes(table))))
    return True


def urdfs() -> Kind:
    content = altered_urdf() | damaged(URDF.encode())
    return Kind("urdf", content, try_urdf, URDF.encode)


def robot_table() -> dict[str, Any]:
    """A ``robot.toml`` with every key."""
    joint = {
        "bus": "can0", "sign": 1, "zero_offset_rad": 0.1, "counts_per_rev": 65536, "gear": 2.0,
        "rated_torque_nm": 20.0, "torque_limit_nm": 40.0, "velocity_limit_rad_s": 6.0,
        "armature": 0.01, "delay_cycles": 1,
    }  # fmt: skip
    return {
        "name": "two", "description": "a robot", "urdf": "two.urdf", "lock": [], "lock_rad": [],
        "home_rad": [0.1, 0.2], "gravity_m_s2": [0.0, 0.0, -9.8], "profile": "cia402",
        "gains": {"lam": 9.0, "k": [8.0, 9.0]},
        "joint": [
            {"name": "shoulder", "node_id": 1, **joint},
            {"name": "elbow", "node_id": 2, **joint},
        ],
    }  # fmt: skip


def try_robot(content: bytes) -> bool:
    """Take it for ``robots/two/robot.toml``."""
    with tempfile.TemporaryDirectory() as folder:
        own = Path(folder) / "robots" / "two"
        own.mkdir(parents=True)
        write(own / "two.urdf", URDF.encode())
        write(own / "robot.toml", content)
        table = {
            "name": "fuzz", "robot": {"name": "two"}, "duration_s": 0.02,
            "reference": {"kind": "hold"}, "control": {"law": "computed_torque"},
        }  # fmt: skip
        with mock.patch.object(robot_config, "robots_dir", return_value=own.parent):
            run_moment(open_session(write(Path(folder) / "s.toml", toml_bytes(table))))
    return True


def robots() -> Kind:
    table = robot_table()
    content = altered(table).map(toml_bytes) | damaged(toml_bytes(table))
    return Kind("robot", content, try_robot, lambda: toml_bytes(table))


def calibration_table() -> dict[str, Any]:
    """A calibration of the robot of :data:`URDF`, with every key."""
    joint = {
        "viscous": 0.1, "viscous_std": 0.01, "coulomb": 0.2, "coulomb_std": 0.01, "offset": 0.0,
        "offset_std": 0.1, "armature": 0.01, "armature_std": 0.001, "torque_constant": 1.01,
        "torque_constant_std": 0.01, "not_excited": ["offset"],
        "gains": {"floor_nm": 0.1, "inflation": 2.0},
    }  # fmt: skip
    return {
        "format": 1, "robot": "two", "source": "x", "seconds": 10.0, "false_alarms_per_hour": 0.1,
        "held_out_percent": [1.0, 2.0],
        "link": [{"joint": "elbow", "mass_kg": 3.0, "mass_std_kg": 0.1,
                  "first_moment_kg_m": [0.0, 0.0, 0.45],
                  "inertia_kg_m2": [0.09, 0.0, 0.09, 0.0, 0.0, 0.01]}],
        "joint": [{"name": "shoulder", **joint}, {"name": "elbow", **copy_of(joint)}],
    }  # fmt: skip


def with_file(key: str, name: str) -> Callable[[bytes], bool]:
    """Return what takes content for the file that ``control.<key>`` names."""

    def take(content: bytes) -> bool:
        with tempfile.TemporaryDirectory() as folder:
            urdf = write(Path(folder) / "two.urdf", URDF.encode())
            path = write(Path(folder) / name, content)
            table = {
                "name": "fuzz", "robot": {"urdf": str(urdf)}, "duration_s": 0.02,
                "reference": {"kind": "hold"}, "control": {key: str(path), "ftc": True},
            }  # fmt: skip
            run_moment(open_session(write(Path(folder) / "s.toml", toml_bytes(table))))
        return True

    return take


def calibrations() -> Kind:
    table = calibration_table()
    content = altered(table).map(toml_bytes) | damaged(toml_bytes(table))
    take = with_file("calibration", "c.toml")
    return Kind("calibration", content, take, lambda: toml_bytes(table))


@cache
def identification_arrays() -> dict[str, Any]:
    """Members of an identification of the robot of :data:`URDF`."""
    m = 9 * 5
    return {
        "format": np.int64(1), "robot": np.array("two"), "joints": np.array(["shoulder", "elbow"]),
        "grid": np.array([9, 5]), "width": np.float64(1.0),
        "q_range": np.array([[-2.0, 2.0], [-2.0, 2.0]]), "v_range": np.array([8.0, 8.0]),
        "w_fo": np.full((2, m), 0.01), "w_go": np.zeros((2, m)),
        "visited": np.ones((2, m), dtype=bool), "interconnection": np.array("desired"),
        "calibration": np.array(""), "source": np.array(""), "seconds": np.float64(1.0),
    }  # fmt: skip


def npz_bytes(arrays: dict[str, Any], compressed: bool = False) -> bytes:
    """The arrays as an NPZ archive."""
    stream = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, **arrays)
    return stream.getvalue()


_ARRAYS = (
    np.zeros(0), np.zeros((0, 5)), np.full((2, 45), np.nan), np.full((2, 45), 1e300),
    np.int64(2**62),
    np.array([[1, 2], [3, 4]]), np.array(["x" * 50]), np.array([None, {}], dtype=object),
    np.zeros((2, 45), dtype=complex), np.zeros(3, dtype="M8[s]"), np.zeros(2, dtype=[("a", "f8")]),
    np.array(b"x"), np.float16(1.0), np.full((2, 2), np.inf), np.array([99, 99]), np.array([0, -1]),
    np.zeros((2, 45), dtype=np.longdouble), np.array(["shoulder", "elbow"] * 40), np.uint8(1),
    np.zeros(8 << 20), np.array("\0\ud800", dtype="U2"),
)  # fmt: skip


@st.composite
def altered_archive(draw: Draw) -> bytes:
    """The archive with members replaced, scaled, removed or added."""
    arrays = dict(identification_arrays())
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(sorted(arrays) or ["x"]))
        how = draw(st.integers(0, 5))
        if how <= 3:
            arrays[name] = draw(st.sampled_from(_ARRAYS))
        elif how == 4:
            arrays.pop(name, None)
        else:
            arrays[draw(st.sampled_from(("x", "\0", "../x", "w_fo.npy")))] = np.zeros(2)
    return npz_bytes(arrays, compressed=draw(st.booleans()))


def identifications() -> Kind:
    content = altered_archive() | damaged(npz_bytes(identification_arrays()))
    whole = partial(npz_bytes, identification_arrays())
    return Kind("identification", content, with_file("identification", "i.npz"), whole)


def try_motion(content: bytes) -> bool:
    """Take it for the CSV file of a reference."""
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder) / "m.csv", content)
        table = {
            "name": "fuzz", "robot": {"plant": "arm2"}, "duration_s": 0.02,
            "reference": {"kind": "csv", "file": str(path)}, "control": {"law": "computed_torque"},
        }  # fmt: skip
        run_moment(open_session(write(Path(folder) / "s.toml", toml_bytes(table))))
    return True


MOTION = b"t,q_1,q_2\n0.0,0.5,0.3\n0.5,0.6,0.4\n1.0,0.7,0.3\n2.0,0.5,0.3\n"
_CELLS = ("nan", "1e300", "-1e300", "", "x", "1e-320", "inf", "\0", "1,2", '"', "0", "0.5")


@st.composite
def altered_motion(draw: Draw) -> bytes:
    """The motion with cells replaced."""
    rows = [row.split(",") for row in MOTION.decode().splitlines()]
    for _ in range(draw(st.integers(1, 3))):
        row = draw(st.sampled_from(rows))
        row[draw(st.integers(0, len(row) - 1))] = draw(st.sampled_from(_CELLS))
    return "\n".join(",".join(row) for row in rows).encode()


def motions() -> Kind:
    return Kind("motion", altered_motion() | damaged(MOTION), try_motion, lambda: MOTION)


@cache
def short_log() -> bytes:
    """A log of a moment, with frames, its chunks uncompressed as far as they can be."""
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder) / "s.toml", SCENARIO.encode())
        log = Path(folder) / "run.mcap"
        with quiet():
            simulate(path, log=log, frames=True)
        return log.read_bytes()


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Drop what a command prints."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        yield


def _log_command(name: str) -> Callable[[bytes], bool]:
    def take(content: bytes) -> bool:
        with tempfile.TemporaryDirectory() as folder, quiet():
            log = write(Path(folder) / "run.mcap", content)
            to = Path(folder)
            if name == "analyze":
                analyze(log, json=True)
            elif name == "report":
                report(log, output=to / "r.html")
            elif name == "recover":
                recover(log, output=to / "whole.mcap")
            elif name == "export":
                export(log, output=to / "f.log")
                export(log, output=to / "f.npz")
            else:
                replay(log)
        return True

    return take


@st.composite
def altered_log(draw: Draw) -> bytes:
    """The log with its records' insides changed and their checksums made right again."""
    return reseal(short_log(), draw)


def logs() -> list[Kind]:
    content = st.deferred(lambda: damaged(short_log()) | altered_log())
    return [
        Kind(name, content, _log_command(name), short_log)
        for name in ("analyze", "report", "recover", "export", "replay")
    ]


def try_eds(content: bytes) -> bool:
    """Read an object dictionary, which is no user's file but a part of the package."""
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder) / EDS_PATH.name, content)
        with mock.patch.object(eds, "EDS_PATH", path):
            assert eds.dictionary.__wrapped__(1)
    return True


def electronic_data_sheets() -> Kind:
    data = EDS_PATH.read_bytes()
    return Kind("eds", damaged(data), try_eds, lambda: data)


def every_kind() -> list[Kind]:
    """All of them."""
    return [
        scenarios(), robots(), urdfs(), calibrations(), identifications(), motions(),
        electronic_data_sheets(), *logs(),
    ]  # fmt: skip


def survive(kind: Kind, content: bytes) -> str:
    """Give it to its reader: ``accepted``, ``refused``; anything else is raised."""
    with bounded():
        try:
            kind.take(content)
        except (InputError, EnvironmentLacksError) as error:  # exit codes 2 and 3
            one_line(error)
            return "refused"
        except DftcError as error:
            one_line(error)
            return "failed"
    return "accepted"
