"""Object dictionary of the emulated drives over SDO: access rules of CiA 301."""

import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dftc_rt.drives.cia402 import states
from dftc_rt.drives.cia402.objects import EDS_PATH
from hil.drive import slots
from tests.unit.drives.drive_bus import DriveBus, drives_of, read, scales, write

NOT_MAPPABLE, TOO_LONG = 0x0604_0041, 0x0604_0042
NO_OBJECT, NO_SUB, READ_ONLY = 0x0602_0000, 0x0609_0011, 0x0601_0002
INVALID, HIGH, LOW, LENGTH = 0x0609_0030, 0x0609_0031, 0x0609_0032, 0x0607_0010
UNSUPPORTED, STATE = 0x0601_0000, 0x0800_0022


@pytest.fixture
def bus() -> DriveBus:
    return DriveBus(drives_of(scales(1, gear=50.9)))


def test_every_readable_object_answers(bus: DriveBus) -> None:
    dictionary = canopen.import_od(str(EDS_PATH), 1)
    for index, entry in dictionary.items():
        if index < 0x1000:
            continue  # dummies are for mapping only
        single = isinstance(entry, canopen.objectdictionary.ODVariable)
        for variable in [entry] if single else entry.values():
            if variable.index == 0x1003 and variable.subindex:
                continue  # there is no error yet
            read(bus, 1, variable.index, variable.subindex)


def test_identity_and_data_sheet(bus: DriveBus) -> None:
    assert read(bus, 1, 0x1000) == 0x0002_0192  # servo drive (2) of profile 402
    assert read(bus, 1, 0x6502) == 1 << 9
    assert read(bus, 1, 0x6076) == 50_000  # mNm
    assert (read(bus, 1, 0x608F, 1), read(bus, 1, 0x608F, 2)) == (1000, 1)
    assert (read(bus, 1, 0x6091, 1), read(bus, 1, 0x6091, 2)) == (509, 10)


def test_process_objects_are_live(bus: DriveBus) -> None:
    bus.drives.objects[0, slots.POSITION] = -5
    bus.drives.objects[0, slots.VELOCITY] = 2**31 + 1
    bus.drives.objects[0, slots.TORQUE_ACTUAL] = -1
    assert read(bus, 1, 0x6064) == 2**32 - 5
    assert read(bus, 1, 0x606C) == 2**31 + 1
    assert read(bus, 1, 0x6077) == 0xFFFF
    assert write(bus, 1, 0x6071, 0, -7, 2) == 0
    assert bus.drives.objects[0, slots.TARGET_TORQUE] == -7
    assert read(bus, 1, 0x6071) == 0x10000 - 7


def test_controlword_acts_before_the_next_read(bus: DriveBus) -> None:
    for word, state in ((6, 2), (7, 3), (15, 4), (0, 1)):
        assert write(bus, 1, 0x6040, 0, word, 2) == 0
        assert states.state_of(read(bus, 1, 0x6041)) == state


@pytest.mark.parametrize(
    ("index", "sub", "value", "size", "abort"),
    [
        (0x6041, 0, 0, 2, READ_ONLY),
        (0x6064, 0, 0, 4, READ_ONLY),
        (0x5000, 0, 0, 4, NO_OBJECT),
        (0x1018, 9, 0, 4, NO_SUB),
        (0x6040, 0, 0, 1, LENGTH),
        (0x6060, 0, 8, 1, INVALID),  # cyclic synchronous position: not supported
        (0x605A, 0, 9, 2, HIGH),
        (0x6007, 0, -1, 2, LOW),
        (0x1005, 0, 0x81, 4, HIGH),  # SYNC stays on 80h
        (0x1019, 0, 241, 1, HIGH),
        (0x1019, 0, 1, 1, INVALID),
        (0x1016, 1, 0x80 << 16 | 10, 4, HIGH),
        (0x1016, 2, 0, 4, NO_SUB),
        (0x1003, 0, 3, 1, INVALID),
        (0x60C2, 1, 0, 1, LOW),  # no period at all
        (0x60C2, 2, 64, 1, HIGH),
        (0x1029, 1, 3, 1, HIGH),
        (0x1400, 2, 252, 1, INVALID),  # remote request: not supported
        (0x1800, 2, 241, 1, INVALID),  # reserved
        (0x1800, 3, 10, 2, INVALID),  # not while the PDO exists
        (0x1800, 6, 1, 1, INVALID),
        (0x1800, 1, 0x182, 4, INVALID),  # not while the PDO exists
        (0x1801, 1, 0x2000_0281, 4, INVALID),  # 29 bits
        (0x1801, 1, 0x601, 4, INVALID),  # SDO's own
        (0x1600, 0, 0, 1, UNSUPPORTED),  # mapping of a PDO that exists
    ],
)
def test_refusals(bus: DriveBus, index: int, sub: int, value: int, size: int, abort: int) -> None:
    assert write(bus, 1, index, sub, value, size) == abort


def test_interpolation_period_is_kept_and_reset(bus: DriveBus) -> None:
    assert (read(bus, 1, 0x60C2, 1), read(bus, 1, 0x60C2, 2)) == (1, 0xFD)  # 1 * 10^-3 s
    assert write(bus, 1, 0x60C2, 1, 5, 1) == 0
    assert read(bus, 1, 0x60C2, 1) == 5
    bus.exchange((0, b"\x81\x01"))
    assert read(bus, 1, 0x60C2, 1) == 1


def test_sync_counter_changes_while_the_period_is_0(bus: DriveBus) -> None:
    assert write(bus, 1, 0x1019, 0, 240, 1) == 0
    assert write(bus, 1, 0x1006, 0, 1000, 4) == 0
    assert write(bus, 1, 0x1019, 0, 10, 1) == STATE
    assert read(bus, 1, 0x1019) == 240


def test_mapping_rules(bus: DriveBus) -> None:
    def entry(value: int, sub: int = 1) -> int:
        return write(bus, 1, 0x1A01, sub, value, 4)

    assert entry(0x60410010) == UNSUPPORTED  # the count is not 0 yet
    assert write(bus, 1, 0x1A01, 0, 0, 1) == 0
    assert entry(0x70000010) == NO_OBJECT
    assert entry(0x10000020) == NOT_MAPPABLE  # device type
    assert entry(0x60410008) == NOT_MAPPABLE  # half a statusword
    assert entry(0x60640020, 1) == entry(0x606C0020, 2) == entry(0x60410010, 3) == 0
    assert write(bus, 1, 0x1A01, 0, 3, 1) == TOO_LONG  # ten bytes
    assert write(bus, 1, 0x1A01, 0, 9, 1) == HIGH
    assert write(bus, 1, 0x1A01, 0, 2, 1) == 0
    # A statusword cannot be received.
    assert write(bus, 1, 0x1601, 0, 0, 1) == 0
    assert write(bus, 1, 0x1601, 1, 0x60410010, 4) == NOT_MAPPABLE


def test_mapped_count_beyond_written_entries(bus: DriveBus) -> None:
    assert write(bus, 1, 0x1A03, 0, 0, 1) == 0
    assert write(bus, 1, 0x1A03, 2, 0, 4) == 0  # entry 2 is empty
    assert write(bus, 1, 0x1A03, 0, 2, 1) == NO_OBJECT


def test_error_history(bus: DriveBus) -> None:
    assert read(bus, 1, 0x1003) == 0
    with pytest.raises(LookupError):
        read(bus, 1, 0x1003, 1)
    for code in range(0x2310, 0x231A):
        bus.drives.fault(0, code)
    assert read(bus, 1, 0x1003) == 8
    assert [read(bus, 1, 0x1003, k) for k in (1, 8)] == [0x2319, 0x2312]
    assert write(bus, 1, 0x1003, 0, 0, 1) == 0
    assert read(bus, 1, 0x1003) == 0


def test_segmented_download_works_too(bus: DriveBus) -> None:
    # 21h: initiate, size given, not expedited; 0Bh... the segment: toggle 0, 5 of 7 bytes
    # unused, last: 0000 1011b.
    assert bus.exchange((0x601, bytes.fromhex("21 71 60 00 02000000"))) == [
        (0x581, bytes.fromhex("60 71 60 00 00000000"))
    ]
    assert bus.exchange((0x601, bytes.fromhex("0b 34 12 00 00000000"))) == [
        (0x581, bytes.fromhex("20 00 00 00 00000000"))
    ]
    assert bus.drives.objects[0, slots.TARGET_TORQUE] == 0x1234


@settings(max_examples=300)
@given(st.lists(st.binary(min_size=0, max_size=8), min_size=1, max_size=4))
def test_any_request_is_survived(requests: list[bytes]) -> None:
    bus = FUZZED
    for request in requests:
        answers = bus.exchange((0x601, request))
        if len(request) < 8:
            assert answers == []  # SDO frames have eight bytes
        assert all(len(data) == 8 for can_id, data in answers if can_id == 0x581)
    assert read(bus, 1, 0x1000) == 0x0002_0192


FUZZED = DriveBus(drives_of(scales(1)))


def test_error_of_our_own_is_not_swallowed(bus: DriveBus, monkeypatch: pytest.MonkeyPatch) -> None:
    # canopen's server would log it and answer "general error".
    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("hil.drive.service.control", broken)
    with pytest.raises(ZeroDivisionError):
        write(bus, 1, 0x6040, 0, 6, 2)
