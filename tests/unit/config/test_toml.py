from typing import Annotated, Any, Literal

import msgspec
import pytest

from dftc_rt.config import toml
from dftc_rt.errors import InputError, MissingFileError


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    kind: Literal["loss", "ramp"]
    effectiveness: Annotated[float, msgspec.Meta(ge=0, le=1)] = 1.0

    def __post_init__(self) -> None:
        if self.kind == "ramp" and self.effectiveness == 0.0:
            raise InputError("effectiveness", "found 0", "more for a ramp")


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    gain: float | tuple[float, ...] = 1.0
    entry: tuple[Entry, ...] = ()
    free: dict[str, float] = {}


class Shape(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", kw_only=True
):
    joint: str


class Step(Shape, frozen=True, tag="step", kw_only=True):
    to: Annotated[float, msgspec.Meta(ge=0, le=1)]


class Wave(Shape, frozen=True, tag="wave", kw_only=True):
    period_s: float = 1.0


class Config(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    name: str
    table: Table | None = None
    shape: tuple[Step | Wave, ...] = ()


def refused(raw: dict[str, Any]) -> str:
    with pytest.raises(InputError) as caught:
        toml.convert(raw, Config, "f.toml")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_file_becomes_a_struct(tmp_path):
    path = tmp_path / "f.toml"
    path.write_text('name = "a"\n[table]\ngain = [1, 2.5]\n[[table.entry]]\nkind = "loss"\n')
    config = toml.load(path, Config)
    assert config == Config(name="a", table=Table(gain=(1.0, 2.5), entry=(Entry(kind="loss"),)))


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        ({}, "f.toml: name: missing (expected this key)"),
        ({"nam": "a", "name": "a"}, "f.toml: nam: unknown key (expected 'name')"),
        ({"name": 1}, "f.toml: name: found 1 (expected a string)"),
        ({"name": "a", "table": {"x": 1}},
         "f.toml: table.x: unknown key (expected one of gain, entry, free)"),
        ({"name": "a", "table": {"gain": "high"}},
         "f.toml: table.gain: found 'high' (expected a number or a list)"),
        ({"name": "a", "table": {"gain": [1, True]}},
         "f.toml: table.gain[1]: found true (expected a number)"),
        ({"name": "a", "table": {"entry": [{"kind": "los"}]}},
         "f.toml: table.entry[0].kind: found 'los' (expected one of loss, ramp)"),
        ({"name": "a", "table": {"entry": [{"kind": "loss", "effectiveness": 2}]}},
         "f.toml: table.entry[0].effectiveness: found 2 (expected a number <= 1.0)"),
        ({"name": "a", "table": {"entry": [{"kind": "ramp", "effectiveness": 0}]}},
         "f.toml: table.entry[0].effectiveness: found 0 (expected more for a ramp)"),
        ({"name": "a", "table": {"entry": [{"kind": "loss"}, {"knd": "loss"}]}},
         "f.toml: table.entry[1].knd: unknown key (expected 'kind')"),
        ({"name": "a", "table": {"free": {"k": "x"}}},
         "f.toml: table.free: found a string (expected a number)"),
        ({"name": "a", "table": {"gain": [1, float("nan")]}},
         "f.toml: table.gain[1]: nan (expected a number)"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_path(raw, message):
    assert refused(raw) == message


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ({"kind": "stp"}, "shape[0].kind: found 'stp' (expected one of step, wave)"),
        ({"kind": 3}, "shape[0].kind: found 3 (expected one of step, wave)"),
        ({"joint": "a"}, "shape[0].kind: missing (expected one of step, wave)"),
        ({"kind": "wave", "joint": "a", "to": 1.0},
         "shape[0].to: unknown key (expected one of kind, joint, period_s)"),
        ({"kind": "wave", "joint": "a", "periods": 1.0},
         "shape[0].periods: unknown key (expected 'period_s')"),
        ({"kind": "step", "joint": "a", "to": 2},
         "shape[0].to: found 2 (expected a number <= 1.0)"),
        ({"kind": "step", "joint": "a"}, "shape[0].to: missing (expected this key)"),
    ],
)  # fmt: skip
def test_one_of_several_tables_lists_its_choices(shape, message):
    assert refused({"name": "a", "shape": [shape]}) == f"f.toml: {message}"


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path):
    path = tmp_path / "f.toml"
    path.write_bytes(b"\xef\xbb\xbfname = 'a'\n")
    assert toml.read(path) == {"name": "a"}


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"a = ", "Invalid value (at end of document)"),
        (b"\xff\xfe", "not a UTF-8 text file"),
        (b"a = 1\na = 2\n", "Cannot overwrite a value"),
        (b"a = " + b"[" * 5000, "nested too deeply"),
    ],
)
def test_files_that_are_no_toml(tmp_path, content, part):
    path = tmp_path / "f.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        toml.read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(MissingFileError, match="no such file"):
        toml.read(tmp_path / "absent.toml")
    with pytest.raises(InputError, match="cannot be read"):
        toml.read(tmp_path)


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("seed=3", {"seed": 3, "fault": [{"rho": 1.0}]}),
        ("fault[0].rho=0.5", {"fault": [{"rho": 0.5}]}),
        ("fault[0].kind=loss", {"fault": [{"rho": 1.0, "kind": "loss"}]}),
        ("fault=[]", {"fault": []}),
        ("control.gains.k=[1, 2]", {"fault": [{"rho": 1.0}], "control": {"gains": {"k": [1, 2]}}}),
        ("bus.x=python-can:pcan", {"fault": [{"rho": 1.0}], "bus": {"x": "python-can:pcan"}}),
        ("on=true", {"on": True, "fault": [{"rho": 1.0}]}),
        ("t=1e-3", {"t": 1e-3, "fault": [{"rho": 1.0}]}),
        ("t=1\nseed = 2", {"t": "1\nseed = 2", "fault": [{"rho": 1.0}]}),
        ("t=", {"t": "", "fault": [{"rho": 1.0}]}),
        ("a=b=c", {"a": "b=c", "fault": [{"rho": 1.0}]}),
    ],
)
def test_overrides(setting, expected):
    raw = {"fault": [{"rho": 1.0}]}
    assert toml.apply_overrides(raw, [setting]) == expected
    assert raw == {"fault": [{"rho": 1.0}]}


def test_later_overrides_build_on_earlier_ones():
    settings = ["fault=[{}, {}]", "fault[1].rho=0.5"]
    assert toml.apply_overrides({}, settings) == {"fault": [{}, {"rho": 0.5}]}


@pytest.mark.parametrize(
    ("setting", "part"),
    [
        ("seed", "no '='"),
        ("=1", "no key path"),
        ("a..b=1", "no key path"),
        ("a[-1]=1", "no key path"),
        ("fault[1].rho=1", "has no entry 1 (expected an index below 1)"),
        ("absent[0].rho=1", "has no entry 0"),
        ("name.x=1", "'name' is no table"),
        ("name[0]=1", "'name' is no list"),
        ("fault.rho=1", "'fault' is no table"),
    ],
)
def test_overrides_with_a_bad_path(setting, part):
    with pytest.raises(InputError) as caught:
        toml.apply_overrides({"name": "a", "fault": [{}]}, [setting])
    assert str(caught.value).startswith(f"--set {setting}: ")
    assert part in str(caught.value)
