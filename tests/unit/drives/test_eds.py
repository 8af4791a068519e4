"""The EDS file: what it lists exists, what exists is listed, defaults are CiA 402's."""

from configparser import RawConfigParser
from pathlib import Path

import canopen
import pytest

from dftc_rt.drives.cia402 import eds
from dftc_rt.drives.cia402.objects import EDS_PATH
from dftc_rt.errors import EnvironmentLacksError

# The objects of the issue, written out.
WANTED = [
    0x1000, 0x1001, 0x1003, 0x1005, 0x1006, 0x1008, 0x1014, 0x1016, 0x1017, 0x1018, 0x1019, 0x1029,
    0x1200, *range(0x1400, 0x1404), *range(0x1600, 0x1604), *range(0x1800, 0x1804),
    *range(0x1A00, 0x1A04), 0x6007, 0x603F, 0x6040, 0x6041, 0x605A, 0x605E, 0x6060, 0x6061,
    0x6064, 0x606C, 0x6071, 0x6072, 0x6076, 0x6077, 0x6080, 0x608F, 0x6091, 0x60C2, 0x6502,
]  # fmt: skip
DUMMIES = range(2, 8)


@pytest.fixture(scope="module")
def text() -> RawConfigParser:
    parser = RawConfigParser()  # strict: a section or key that stands twice is an error
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    with EDS_PATH.open(encoding="ascii") as file:
        parser.read_file(file)
    return parser


@pytest.fixture(scope="module")
def dictionary() -> canopen.ObjectDictionary:
    return canopen.import_od(str(EDS_PATH), 5)


def test_lists_name_every_object_once(text: RawConfigParser) -> None:
    listed: list[int] = []
    for section in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        count = text.getint(section, "SupportedObjects")
        assert len(text.options(section)) == count + 1
        listed += [int(text.get(section, str(k)), 16) for k in range(1, count + 1)]
    assert sorted(listed) == sorted(WANTED)
    sections = {int(name, 16) for name in text.sections() if len(name) == 4}
    assert sections == set(WANTED)


def test_canopen_reads_all_of_it(dictionary: canopen.ObjectDictionary) -> None:
    assert sorted(dictionary) == sorted([*WANTED, *DUMMIES])


def test_sub_numbers_count_the_entries(text: RawConfigParser) -> None:
    for name in text.sections():
        if text.has_option(name, "SubNumber"):
            entries = [s for s in text.sections() if s.startswith(f"{name}sub")]
            assert int(text.get(name, "SubNumber"), 16) == len(entries), name


def test_values_lie_within_their_limits(dictionary: canopen.ObjectDictionary) -> None:
    for entry in dictionary.values():
        for variable in (
            [entry] if isinstance(entry, canopen.objectdictionary.ODVariable) else (entry.values())
        ):
            if variable.default is None or isinstance(variable.default, str):
                continue
            assert variable.min is None or variable.default >= variable.min, variable
            assert variable.max is None or variable.default <= variable.max, variable
            assert len(variable.encode_raw(variable.default)) * 8 == len(variable)


def test_power_on_mapping_lets_any_master_talk(dictionary: canopen.ObjectDictionary) -> None:
    # CiA 402-2: RPDO1 is the controlword, TPDO1 the statusword, both of type 255, on the
    # pre-defined identifiers; bit 30 of a TPDO says that it cannot be requested.
    assert dictionary[0x1400][1].default == 0x200 + 5
    assert dictionary[0x1800][1].default == 0x4000_0000 | 0x180 + 5
    assert dictionary[0x1400][2].default == dictionary[0x1800][2].default == 255
    assert (dictionary[0x1600][0].default, dictionary[0x1600][1].default) == (1, 0x60400010)
    assert (dictionary[0x1A00][0].default, dictionary[0x1A00][1].default) == (1, 0x60410010)
    for number in (1, 2, 3):
        assert dictionary[0x1400 + number][1].default & 1 << 31
        assert dictionary[0x1800 + number][1].default & 1 << 31


def test_nothing_beyond_the_standards(dictionary: canopen.ObjectDictionary) -> None:
    # No manufacturer's objects (2000h to 5FFFh): the wire has no place for the truth.
    assert not [index for index in dictionary if 0x2000 <= index < 0x6000]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "dftc402.eds of the drive profile cannot be read: "),
        (b"[DeviceInfo]\n", "dftc402.eds of the drive profile is not the file that belongs to it"),
    ],
    ids=["missing", "damaged"],
)
def test_no_other_file_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes | None, says: str
) -> None:
    path = tmp_path / EDS_PATH.name
    if content is not None:
        path.write_bytes(content)
    monkeypatch.setattr(eds, "EDS_PATH", path)
    with pytest.raises(EnvironmentLacksError, match=says):
        eds.dictionary.__wrapped__(1)
