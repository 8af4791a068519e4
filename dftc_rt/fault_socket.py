"""Faults for a rig that runs: what is asked of it over its Unix socket, and how to ask.

A datagram holds one request as JSON, decoded strictly, and is answered by one. The socket lies in
the private directory of the run, so whoever is not its user cannot reach it.
"""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path
from typing import Any, Final

import msgspec

from dftc_rt.config.faults import Fault, RobotFault
from dftc_rt.config.fields import Strict
from dftc_rt.errors import InputError

SOCKET: Final = "faults@rig"
"""Name in the directory; no bus can have it."""

DATAGRAM_BYTES: Final = 1024
_PATIENCE_S: Final = 2.0


class Apply(Strict, frozen=True, tag_field="do", tag="apply", kw_only=True):
    """Let this happen from now on; ``start_s`` and ``end_s`` count from now.

    It takes the place of one of the same kind on the same joint that came this way before.
    """

    fault: RobotFault


class Clear(Strict, frozen=True, tag_field="do", tag="clear", kw_only=True):
    """End what is active: of this joint and kind, where given; of the scenario too."""

    joint: str | None = None
    kind: str | None = None


Request = Apply | Clear


class Answer(Strict, frozen=True, kw_only=True):
    """What became of a request.

    Attributes:
        t: Rig time, s.
        refused: Why nothing was changed; "" when it was done.
        text: What was done.
    """

    t: float
    refused: str = ""
    text: str = ""


def kind_of(fault: Fault) -> str:
    """The fault's ``kind``, as a scenario has it."""
    return str(type(fault).__struct_config__.tag)


def fault_table(fault: Fault) -> dict[str, Any]:
    """The fault as a scenario's table; what may be left out and is, is."""
    table: dict[str, Any] = msgspec.to_builtins(fault)
    return {key: value for key, value in table.items() if value is not None}


def ask(directory: Path, request: Request) -> Answer:
    """Ask the rig whose sockets lie in ``directory``, and wait for its answer.

    Raises:
        InputError: No rig takes faults there, or it refuses this one.
    """
    where = directory / SOCKET
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
        own.settimeout(_PATIENCE_S)
        try:
            own.bind("")  # Linux gives it a name that is free, for the answer
            own.connect(str(where))  # and from now on nobody else can answer
            own.send(msgspec.json.encode(request))
            raw = own.recv(DATAGRAM_BYTES)
        except TimeoutError:
            raise InputError(str(where), "no answer", "a rig whose cycles run") from None
        except OSError as error:
            expected = "the directory that dftc hil or dftc rig has printed"
            raise InputError(str(where), error.strerror or str(error), expected) from None
    try:
        answer = msgspec.json.decode(raw, type=Answer)
    except msgspec.DecodeError as error:
        raise InputError(str(where), f"an answer of another program: {error}") from None
    if answer.refused:
        raise InputError("fault", answer.refused)
    return answer


def listen(directory: Path) -> socket.socket:
    """Open the rig's end, in a directory of mode 0700. It never blocks.

    Raises:
        InputError: The path does not fit a socket address, or cannot be made.
    """
    path = directory / SOCKET
    own = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
    try:
        own.bind(str(path))
        path.chmod(0o600)
    except OSError as error:
        own.close()
        raise InputError(str(path), error.strerror or str(error), "a place for a socket") from None
    return own


def close(own: socket.socket, directory: Path) -> None:
    """Close the rig's end and remove it."""
    own.close()
    with contextlib.suppress(OSError):
        (directory / SOCKET).unlink()
