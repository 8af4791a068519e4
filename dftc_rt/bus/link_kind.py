"""What kind of network link an interface is, asked of the kernel over rtnetlink.

sysfs is not enough: a serial CAN adapter (slcan) looks as virtual there as vcan does.
"""

from __future__ import annotations

from dftc_rt.bus.rtnetlink import Link, find_link
from dftc_rt.errors import EnvironmentLacksError


def link_kind(interface: str) -> str | None:
    """Return the kind of a link: ``vcan``, ``slcan``, …, "" for plain hardware; None if absent.

    Raises:
        EnvironmentLacksError: The kernel or the sandbox answers no rtnetlink request.
    """
    link = link_of(interface)
    return None if link is None else link.kind


def link_of(interface: str) -> Link | None:
    """Return a link by name; None if absent.

    Raises:
        EnvironmentLacksError: The kernel or the sandbox answers no rtnetlink request.
    """
    try:
        return find_link(interface)
    except OSError as error:
        raise EnvironmentLacksError(
            f"cannot ask the kernel what {interface} is ({error.strerror or error})",
            "allow AF_NETLINK sockets, or use --bus unix",
        ) from error
