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

from dftc_rt.errors import EnvironmentLacksError


@dataclass(frozen=True, slots=True)
class Signal:
    """One field of a frame, little-endian: physical value = raw · scale + offset.

    Attributes:
        name: Name within its message.
        start: First bit.
        bits: Length.
        signed: Whether the raw value is.
        scale: Physical unit per count.
        offset: Physical value at count 0.
        unit: Physical unit, "" for none.
        choices: Raw value -> name.
    """

    name: str
    start: int
    bits: int
    signed: bool = False
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    choices: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Message:
    """One frame, 11-bit identifier.

    Attributes:
        name: Unique on its bus; letters, digits and ``_``.
        can_id: Identifier.
        length: Data bytes.
        sender: Node that sends it.
        signals: Its fields.
        comment: What it is.
        cycle_ms: How often it comes; None where it is not cyclic, or no whole number.
    """

    name: str
    can_id: int
    length: int
    sender: str
    signals: tuple[Signal, ...]
    comment: str
    cycle_ms: int | None = None


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
        strict=True,  # no fields that overlap or do not fit
    )
    text: str = database.as_dbc_string()
    return text


def _message(message: Message) -> Any:
    from cantools.database.can import Message as CanMessage

    return CanMessage(
        frame_id=message.can_id,
        name=message.name,
        length=message.length,
        signals=[_signal(each) for each in message.signals],
        comment=message.comment,
        senders=[message.sender],
        cycle_time=message.cycle_ms,
    )


def _signal(signal: Signal) -> Any:
    from cantools.database.can import Signal as CanSignal
    from cantools.database.conversion import BaseConversion

    return CanSignal(
        name=signal.name,
        start=signal.start,
        length=signal.bits,
        is_signed=signal.signed,
        conversion=BaseConversion.factory(
            scale=signal.scale,
            offset=signal.offset,
            choices=OrderedDict(signal.choices) if signal.choices else None,
        ),
        unit=signal.unit or None,
    )
