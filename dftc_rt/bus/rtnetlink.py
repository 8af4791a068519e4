"""Requests about network links to the kernel, over rtnetlink.

Source: Linux ``rtnetlink(7)``, ``netlink(7)``, ``include/uapi/linux/if_link.h``.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

_RTM_NEWLINK: Final = 16
_RTM_DELLINK: Final = 17
_RTM_GETLINK: Final = 18
_REQUEST: Final = 0x001
_ACK: Final = 0x004
_EXCLUSIVE: Final = 0x200
_CREATE: Final = 0x400
_NLMSG_ERROR: Final = 2
_IFLA_IFNAME: Final = 3
_IFLA_MTU: Final = 4
_IFLA_TXQLEN: Final = 13
_IFLA_LINKINFO: Final = 18
_IFLA_INFO_KIND: Final = 1
_IFLA_INFO_DATA: Final = 2
_IFF_UP: Final = 1
_NESTED_MASK: Final = 0x3FFF
_NLMSGHDR: Final = struct.Struct("=IHHII")
_IFINFOMSG: Final = struct.Struct("=BxHiII")
_RTATTR: Final = struct.Struct("=HH")
_IFNAMSIZ: Final = 16


@dataclass(frozen=True, slots=True)
class Link:
    """A network link as it is now.

    Attributes:
        index: Its number, which no other link takes while it lives.
        kind: ``vcan``, ``slcan``, …; "" for plain hardware.
        up: Whether it is up.
        mtu: Largest frame, bytes: 16 for classical CAN, 72 for CAN FD.
        queue: Frames that wait in its transmit queue at most.
        data: What its driver tells besides, as it is on netlink; a CAN driver's is decoded by
            ``dftc_rt.bus.can_link``.
    """

    index: int
    kind: str
    up: bool
    mtu: int = 0
    queue: int = 0
    data: bytes = b""


def is_link_name(name: str) -> bool:
    """Return whether the kernel takes a name for a link: 1 to 15 bytes."""
    return 0 < len(os.fsencode(name)) < _IFNAMSIZ


def find_link(name: str) -> Link | None:
    """Return the link of a name, or None.

    Raises:
        OSError: The kernel or the sandbox does not answer.
    """
    if not is_link_name(name):
        return None
    try:
        answer = _ask(_RTM_GETLINK, 0, attributes=_attribute(_IFLA_IFNAME, _text(name)))
    except OSError as error:
        if error.errno == errno.ENODEV:
            return None
        raise
    return parse_link(answer)


def parse_link(answer: bytes) -> Link:
    """Return the link that an answer to RTM_GETLINK describes, its header cut off."""
    _, _, index, flags, _ = _IFINFOMSG.unpack_from(answer)
    found = dict(routing_attributes(answer[_IFINFOMSG.size :]))
    info = dict(routing_attributes(found.get(_IFLA_LINKINFO, b"")))
    return Link(
        index,
        info.get(_IFLA_INFO_KIND, b"").rstrip(b"\0").decode(),
        bool(flags & _IFF_UP),
        _number(found.get(_IFLA_MTU, b"")),
        _number(found.get(_IFLA_TXQLEN, b"")),
        info.get(_IFLA_INFO_DATA, b""),
    )


def add_link(name: str, kind: str) -> None:
    """Make a link that is up; one that has the name already stays as it is.

    Raises:
        OSError: EEXIST, EPERM, EOPNOTSUPP (the kernel has no such kind), or another refusal.
    """
    info = _attribute(_IFLA_INFO_KIND, _text(kind))
    attributes = _attribute(_IFLA_IFNAME, _text(name)) + _attribute(_IFLA_LINKINFO, info)
    _ask(_RTM_NEWLINK, _ACK | _CREATE | _EXCLUSIVE, up=True, attributes=attributes)


def set_link_up(link: Link) -> None:
    """Bring a link up.

    Raises:
        OSError: The kernel refuses.
    """
    _ask(_RTM_NEWLINK, _ACK, index=link.index, up=True)


def set_link_down(link: Link) -> None:
    """Take a link down.

    Raises:
        OSError: The kernel refuses.
    """
    _ask(_RTM_NEWLINK, _ACK, index=link.index, change=_IFF_UP)


def set_link_mtu(link: Link, mtu: int) -> None:
    """Set the largest frame of a link that is down, bytes.

    Raises:
        OSError: The kernel refuses, as it does for a link that is up (EBUSY).
    """
    size = _attribute(_IFLA_MTU, mtu.to_bytes(4, sys.byteorder))
    _ask(_RTM_NEWLINK, _ACK, index=link.index, attributes=size)


def delete_link(link: Link) -> None:
    """Remove a link: this very one, whatever has its name by now.

    Raises:
        OSError: The kernel refuses.
    """
    _ask(_RTM_DELLINK, _ACK, index=link.index)


def _ask(
    message: int,
    flags: int,
    *,
    index: int = 0,
    up: bool = False,
    change: int = 0,
    attributes: bytes = b"",
) -> bytes:
    """Send one request; return the body of the answer, which is empty for an acknowledgement."""
    state = _IFF_UP if up else 0
    body = _IFINFOMSG.pack(socket.AF_UNSPEC, 0, index, state, state | change) + attributes
    header = _NLMSGHDR.pack(_NLMSGHDR.size + len(body), message, _REQUEST | flags, 1, 0)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 0) as route:
        route.settimeout(2.0)
        route.sendto(header + body, (0, 0))
        answer = route.recv(1 << 16)
    _, kind, _, _, _ = _NLMSGHDR.unpack_from(answer)
    if kind != _NLMSG_ERROR:
        return answer[_NLMSGHDR.size :]
    code = -struct.unpack_from("=i", answer, _NLMSGHDR.size)[0]
    if code:
        raise OSError(code, os.strerror(code))
    return b""


def _number(value: bytes) -> int:
    return int.from_bytes(value[:4], sys.byteorder)


def _text(value: str) -> bytes:
    return os.fsencode(value) + b"\0"


def _attribute(kind: int, value: bytes) -> bytes:
    """Return one routing attribute, padded."""
    padding = b"\0" * (-len(value) % 4)
    return _RTATTR.pack(_RTATTR.size + len(value), kind) + value + padding


def routing_attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (type, value) of each routing attribute, type without its flags."""
    at = 0
    while at + _RTATTR.size <= len(data):
        length, kind = _RTATTR.unpack_from(data, at)
        if length < _RTATTR.size:
            return
        yield kind & _NESTED_MASK, data[at + _RTATTR.size : at + length]
        at += (length + 3) & ~3
