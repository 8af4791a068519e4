"""Traffic of one bus as a DBC file, through cantools.

A DBC describes one CAN network: an identifier means one thing in it. So there is one file a
bus.

Source: Vector CANdb++ (DBC file format), as cantools and SavvyCAN read it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from dftc_rt.bus.frame import EFF_FLAG, EFF_MASK
from dftc_rt.errors import EnvironmentLacksError


@dataclass(frozen=True, slots=True)
class Signal:
    """One field of a frame: physical value = raw · scale + offset.

    Attributes:
        name: Name within its message.
        start: First bit: of the least significant, counted from each byte's lowest; with
            ``big_endian`` of the most significant, counted from each byte's highest.
        bits: Length.
        signed: Whether the raw value is.
        scale: Physical unit per count.
        offset: Physical value at count 0.
        unit: Physical unit, "" for none.
        choices: Raw value -> name.
        big_endian: Most significant bit first.
        real: The raw value is an IEEE 754 number of 32 bits.
        selects: Its raw value says which fields with ``when`` are there.
        when: Raw value of the selecting field with which this one is there; None: always.
    """

    name: str
    start: int
    bits: int
    signed: bool = False
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    choices: dict[int, str] = field(default_factory=dict)
    big_endian: bool = False
    real: bool = False
    selects: bool = False
    when: int | None = None


@dataclass(frozen=True, slots=True)
class Message:
    """One frame.

    Attributes:
        name: Unique on its bus; letters, digits and ``_``.
        can_id: Identifier, with EFF_FLAG where it has 29 bits.
        length: Data bytes.
        sender: Node that sends it.
        signals: Its fields.
        comment: What it is.
        cycle_ms: How often it comes; None where it is not cyclic, or no whole number.
        fd: Whether it is a CAN FD frame.
    """

    name: str
    can_id: int
    length: int
    sender: str
    signals: tuple[Signal, ...]
    comment: str
    cycle_ms: int | None = None
    fd: bool = False


def require_cantools() -> None:
    """Refuse to begin without cantools.

    Raises:
        EnvironmentLacksError: It is not installed.
    """
    try:
        import cantools  # noqa: F401
    except ImportError:
        raise EnvironmentLacksError(
            "cantools is not installed", "pip install 'dftc_rt[dbc]'"
        ) from None


def dbc_text(messages: Sequence[Message], version: str) -> str:
    """Return the file's text.

    Args:
        messages: Everything on the bus.
        version: What the file is of, one line.
    """
    from cantools.database import Database
    from cantools.database.can import Node

    senders = dict.fromkeys(message.sender for message in messages)
    database = Database(
        messages=[_message(message) for message in messages],
        nodes=[Node(name) for name in senders],
        version=version,
        dbc_specifics=_fd_bus() if any(message.fd for message in messages) else None,
        strict=True,  # no fields that overlap or do not fit
    )
    text: str = database.as_dbc_string()
    return text


def _fd_bus() -> Any:
    """Return what says that the bus carries CAN FD: the frames' formats are written with it."""
    from cantools.database.can.formats.dbc.dbc_attribute import DbcAttribute
    from cantools.database.can.formats.dbc.dbc_attribute_definition import DbcAttributeDefinition
    from cantools.database.can.formats.dbc.dbc_specifics import DbcSpecifics

    definition = DbcAttributeDefinition("BusType", default_value="CAN", type_name="STRING")
    return DbcSpecifics(
        attributes=OrderedDict(BusType=DbcAttribute("CAN FD", definition)),
        attribute_definitions=OrderedDict(BusType=definition),
    )


def _message(message: Message) -> Any:
    from cantools.database.can import Message as CanMessage

    selector = next((each.name for each in message.signals if each.selects), None)
    return CanMessage(
        frame_id=message.can_id & EFF_MASK,
        is_extended_frame=bool(message.can_id & EFF_FLAG),
        is_fd=message.fd,
        name=message.name,
        length=message.length,
        signals=[_signal(each, selector) for each in message.signals],
        comment=message.comment,
        senders=[message.sender],
        cycle_time=message.cycle_ms,
    )


def _signal(signal: Signal, selector: str | None) -> Any:
    from cantools.database.can import Signal as CanSignal
    from cantools.database.conversion import BaseConversion

    start = signal.start
    if signal.big_endian:  # the format counts from each byte's lowest bit in any case
        start = start // 8 * 8 + 7 - start % 8
    return CanSignal(
        name=signal.name,
        start=start,
        length=signal.bits,
        byte_order="big_endian" if signal.big_endian else "little_endian",
        is_signed=signal.signed,
        is_multiplexer=signal.selects,
        multiplexer_ids=None if signal.when is None else [signal.when],
        multiplexer_signal=None if signal.when is None else selector,
        conversion=BaseConversion.factory(
            scale=signal.scale,
            offset=signal.offset,
            choices=OrderedDict(signal.choices) if signal.choices else None,
            is_float=signal.real,
        ),
        unit=signal.unit or None,
    )
