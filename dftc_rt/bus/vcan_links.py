"""Makes and removes the vcan links of the rig's buses; touches no link of another kind.

Source: Linux ``networking/can``, "CAN network drivers", "The Virtual CAN Driver (vcan)".
"""

from __future__ import annotations

import contextlib
import errno
import socket
from collections.abc import Sequence

from dftc_rt.bus.frame import FD_FRAME_SIZE
from dftc_rt.bus.link_kind import link_of
from dftc_rt.bus.rtnetlink import (
    Link,
    add_link,
    delete_link,
    find_link,
    is_link_name,
    set_link_down,
    set_link_mtu,
    set_link_up,
)
from dftc_rt.errors import EnvironmentLacksError, InputError

_INSTEAD = "or do without: --bus unix needs neither"


def bring_up(names: Sequence[str], *, fd: bool = False) -> dict[str, str]:
    """See to it that vcan links are there and up: all of them, or none is made.

    Args:
        names: Links, such as ``vcan0``.
        fd: Whether they are to carry CAN FD; one that does not is taken down for a moment.

    Returns:
        Name -> what was done: ``made``, ``brought up`` or ``was up``; with the mtu, if that
        was changed.

    Raises:
        InputError: A name belongs to a link that is no vcan, or is none for a link.
        EnvironmentLacksError: The kernel has no SocketCAN or no vcan, or permits it not.
    """
    _check_socketcan()
    links = _vcan_links(names)
    made: list[str] = []
    done: dict[str, str] = {}
    try:
        for name, link in links.items():
            if link is None:
                add_link(name, "vcan")
                made.append(name)
                link = find_link(name) if fd else None
                done[name] = "made" + _carry_fd(link)
            else:
                done[name] = "was up" if link.up else "brought up"
                changed = _carry_fd(link if fd else None)
                if not link.up and not changed:
                    set_link_up(link)
                done[name] += changed
    except OSError as error:
        with contextlib.suppress(OSError):  # the first refusal is the one to tell
            take_down(made)
        raise _refusal(f"make {name}", error) from error
    return done


def take_down(names: Sequence[str]) -> dict[str, str]:
    """Remove vcan links; those that are not there need no removing.

    Args:
        names: Links, such as ``vcan0``.

    Returns:
        Name -> what was done: ``removed`` or ``was not there``.

    Raises:
        InputError: A name belongs to a link that is no vcan: none is removed then.
        EnvironmentLacksError: The kernel permits it not.
    """
    done: dict[str, str] = {}
    for name, link in _vcan_links(names).items():
        done[name] = "was not there" if link is None else "removed"
        if link is not None:
            try:
                delete_link(link)
            except OSError as error:
                if error.errno != errno.ENODEV:  # somebody else was faster
                    raise _refusal(f"remove {name}", error) from error
    return done


def check_fd(names: Sequence[str], remedy: str) -> None:
    """Refuse vcan links that would refuse the first CAN FD frame.

    Raises:
        EnvironmentLacksError: One carries classical frames only.
    """
    for name in names:
        link = link_of(name)
        if link is not None and link.mtu < FD_FRAME_SIZE:
            raise EnvironmentLacksError(
                f"{name} carries classical frames only (mtu {link.mtu}), "
                f"this profile's are CAN FD (mtu {FD_FRAME_SIZE})",
                remedy,
            )


def _carry_fd(link: Link | None) -> str:
    """Have a link carry CAN FD, and be up; return what that changed.

    Raises:
        OSError: The kernel refuses.
    """
    if link is None or link.mtu >= FD_FRAME_SIZE:
        return ""
    if link.up:
        set_link_down(link)
    set_link_mtu(link, FD_FRAME_SIZE)
    set_link_up(link)
    return f", mtu {link.mtu} -> {FD_FRAME_SIZE}"


def _vcan_links(names: Sequence[str]) -> dict[str, Link | None]:
    """Look at every link before any is touched."""
    links: dict[str, Link | None] = {}
    for name in names:
        if not is_link_name(name):
            raise InputError(name, "no name for a link", "at most 15 characters")
        links[name] = link_of(name)
        found = links[name]
        if found is not None and found.kind != "vcan":
            raise InputError(name, f"a link of kind {found.kind or 'hardware'}", "kind vcan")
    return links


def _check_socketcan() -> None:
    """Refuse to begin where nobody could open the links."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        raise EnvironmentLacksError(
            f"no SocketCAN in this kernel ({error.strerror})",
            f"modprobe can-raw vcan, as root, where the kernel has these modules; {_INSTEAD}",
        ) from error


def _refusal(what: str, error: OSError) -> EnvironmentLacksError:
    if error.errno in (errno.EPERM, errno.EACCES):
        return EnvironmentLacksError(
            f"not permitted to {what}", f"run this as root (capability NET_ADMIN), {_INSTEAD}"
        )
    if error.errno == errno.EOPNOTSUPP:
        return EnvironmentLacksError(
            f"this kernel has no vcan (cannot {what})",
            f"modprobe vcan, as root, where the kernel has this module; {_INSTEAD}",
        )
    return EnvironmentLacksError(
        f"cannot {what} ({error.strerror})", f"see ip -d link show type vcan; {_INSTEAD}"
    )
