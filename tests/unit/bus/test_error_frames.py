"""Error frames as the kernel's drivers make them; bytes by hand from linux/can/error.h."""

from __future__ import annotations

from dftc_rt.bus.error_frames import ErrorCounts, restart_frame, state_frame
from dftc_rt.bus.frame import unpack

ERR = 0x2000_0000


def data(*given: int) -> bytes:
    return bytes(given).ljust(8, b"\0")


def test_a_node_alone_on_its_bus_goes_passive_and_stays() -> None:
    # CAN_ERR_ACK | CAN_ERR_BUSERROR | CAN_ERR_CNT, as with berr-reporting on
    errors = ErrorCounts()
    assert errors.take(ERR | 0x2A0, data(0, 0, 0, 0, 0, 0, 8, 0)) == (
        "no acknowledgement", "bus error",
    )  # fmt: skip
    # CAN_ERR_CRTL | CAN_ERR_CNT: TX_WARNING, then TX_PASSIVE
    told = errors.take(ERR | 0x204, data(0, 0x08, 0, 0, 0, 0, 96, 0))
    assert told == ("over 95 errors (errors as sender 96, as receiver 0)",)
    told = errors.take(ERR | 0x204, data(0, 0x20, 0, 0, 0, 0, 128, 0))
    assert told == ("error passive (errors as sender 128, as receiver 0)",)
    assert errors.take(ERR | 0x204, data(0, 0x20, 0, 0, 0, 0, 128, 0)) == ()
    assert (errors.state, errors.tec, errors.rec, errors.frames) == ("passive", 128, 0, 4)


def test_bus_off_and_back() -> None:
    errors = ErrorCounts()
    assert errors.take(ERR | 0x040, data()) == ("bus-off",)
    assert errors.state == "bus-off"
    assert errors.take(ERR | 0x100, data()) == ("error active again", "restart")
    assert errors.state == "active"


def test_a_flood_is_told_at_powers_of_ten() -> None:
    errors = ErrorCounts()
    told = [text for _ in range(150) for text in errors.take(ERR | 0x008, data(0, 0, 0x80))]
    assert told == ["protocol error", "protocol error (10 so far)", "protocol error (100 so far)"]
    assert errors.summary() == "150 protocol error"


def test_overflows_of_the_controller_are_no_change_of_state() -> None:
    errors = ErrorCounts()
    assert errors.take(ERR | 0x004, data(0, 0x01)) == ("receive overflow",)
    assert errors.take(ERR | 0x004, data(0, 0x02)) == ("transmit overflow",)
    assert errors.state == "active"


def test_a_short_frame_and_an_unknown_class_are_no_crash() -> None:
    errors = ErrorCounts()
    assert errors.take(ERR | 0x0008_0000, b"") == ()
    assert errors.take(ERR | 0x002, b"\x05") == ("lost arbitration",)


def test_frames_of_an_emulated_interface_are_those_of_a_driver() -> None:
    assert unpack(state_frame("bus-off")) == (ERR | 0x040, data())
    assert unpack(state_frame("passive", 300, 7)) == (
        ERR | 0x204, data(0, 0x30, 0, 0, 0, 0, 255, 7),
    )  # fmt: skip
    assert unpack(restart_frame()) == (ERR | 0x100, data())
