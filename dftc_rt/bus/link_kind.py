"""What kind of network link an interface is, asked of the kernel over rtnetlink.

sysfs is not enough: a serial CAN adapter (slcan) looks as virtual there as vcan does.

Source: Linux ``rtnetlink(7)``, ``include/uapi/linux/if_link.h``.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
from collections.abc import Iterator
from typing import Final

from dftc_rt.errors import EnvironmentLacksError

_RTM_GETLINK: Final = 18
_NLM_F_REQUEST: Final = 1
_NLMSG_ERROR: Final = 2
_IFLA_IFNAME: Final = 3
_IFLA_LINKINFO: Final = 18
_IFLA_INFO_KIND: Final = 1
_NESTED_MASK: Final = 0x3FFF
_NLMSGHDR: Final = struct.Struct("=IHHII")
_IFINFOMSG: Final = struct.Struct("=BxHiII")
_RTATTR: Final = struct.Struct("=HH")
_IFNAMSIZ: Final = 16


def link_kind(interface: str) -> str | None:
    """Return the kind of a link: ``vcan``, ``slcan``, …, "" for plain hardware; None if absent.

    Raises:
        EnvironmentLacksError: The kernel or the sandbox answers no rtnetlink request.
    """
    name = os.fsencode(interface)
    if not 0 < len(name) < _IFNAMSIZ:
        return None
    try:
        answer = _ask(name)
    except OSError as error:
        raise EnvironmentLacksError(
            f"cannot ask the kernel what {interface} is ({error.strerror})",
            "allow AF_NETLINK sockets, or use --bus unix",
        ) from error
    _, kind, _, _, _ = _NLMSGHDR.unpack_from(answer)
    if kind == _NLMSG_ERROR:
        code = -struct.unpack_from("=i", answer, _NLMSGHDR.size)[0]
        if code == errno.ENODEV:
            return None
        raise EnvironmentLacksError(
            f"the kernel does not say what {interface} is ({os.strerror(code)})",
            "use --bus unix",
        )
    for attribute, value in _attributes(answer[_NLMSGHDR.size + _IFINFOMSG.size :]):
        if attribute == _IFLA_LINKINFO:
            for inner, text in _attributes(value):
                if inner == _IFLA_INFO_KIND:
                    return text.rstrip(b"\0").decode()
    return ""


def _ask(name: bytes) -> bytes:
    value = name + b"\0"
    attribute = _RTATTR.pack(_RTATTR.size + len(value), _IFLA_IFNAME) + value
    attribute += b"\0" * (-len(attribute) % 4)
    body = _IFINFOMSG.pack(socket.AF_UNSPEC, 0, 0, 0, 0) + attribute
    header = _NLMSGHDR.pack(_NLMSGHDR.size + len(body), _RTM_GETLINK, _NLM_F_REQUEST, 1, 0)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 0) as route:
        route.settimeout(2.0)
        route.sendto(header + body, (0, 0))
        return route.recv(1 << 16)


def _attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (type, value) of each routing attribute."""
    at = 0
    while at + _RTATTR.size <= len(data):
        length, kind = _RTATTR.unpack_from(data, at)
        if length < _RTATTR.size:
            return
        yield kind & _NESTED_MASK, data[at + _RTATTR.size : at + length]
        at += (length + 3) & ~3
