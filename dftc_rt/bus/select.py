"""Which kind of bus a rig runs on: vcan where the kernel has it, else the user-space bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from dftc_rt.bus.link_kind import link_kind
from dftc_rt.errors import EnvironmentLacksError, InputError

BusKind = Literal["vcan", "unix", "inprocess"]
INTERFACES: Final = ("auto", "vcan", "unix", "inprocess")


@dataclass(frozen=True, slots=True)
class BusChoice:
    """What was chosen, and why.

    Attributes:
        kind: ``vcan``, ``unix`` or ``inprocess``.
        reason: One line for the user.
        interfaces: Logical bus name → vcan interface; empty for the other kinds.
    """

    kind: BusKind
    reason: str
    interfaces: dict[str, str] = field(default_factory=dict)


def vcan_name(bus: str) -> str:
    """Return the vcan interface that stands in for a logical bus: ``vcan0`` for ``can0``."""
    return f"v{bus}"


def choose_bus(
    interface: str, buses: Sequence[str], kind_of: Callable[[str], str | None] = link_kind
) -> BusChoice:
    """Choose the transport of a rig's buses. Never a real bus.

    Args:
        interface: ``auto``, ``vcan``, ``unix`` or ``inprocess``.
        buses: Logical bus names.
        kind_of: Tells the kind of a link (``link_kind``).

    Raises:
        InputError: ``interface`` is something else, or a link has the name but is no vcan.
        EnvironmentLacksError: ``vcan`` was asked for and a link is missing.
    """
    if interface == "unix":
        return BusChoice("unix", "user-space bus, as asked for")
    if interface == "inprocess":
        return BusChoice("inprocess", "in one process, as asked for")
    if interface not in INTERFACES:
        raise InputError("bus.interface", repr(interface), ", ".join(INTERFACES))
    names = {bus: vcan_name(bus) for bus in buses}
    if interface == "auto":
        return _automatic(names, kind_of)
    for bus, name in names.items():
        kind = kind_of(name)
        if kind is None:
            raise EnvironmentLacksError(
                f"no interface {name} for the bus {bus}",
                f"dftc bus up {','.join(buses)}, as root; or --bus unix",
            )
        if kind != "vcan":
            raise InputError(name, f"a link of kind {kind or 'hardware'}", "kind vcan")
    return BusChoice("vcan", f"vcan links {', '.join(names.values())}, as asked for", names)


def _automatic(names: dict[str, str], kind_of: Callable[[str], str | None]) -> BusChoice:
    for name in names.values():
        try:
            kind = kind_of(name)
        except EnvironmentLacksError as error:
            return BusChoice("unix", f"user-space bus: {error.lacks}")
        if kind != "vcan":
            found = "is missing" if kind is None else f"is of kind {kind or 'hardware'}, not vcan"
            return BusChoice("unix", f"user-space bus: {name} {found}")
    return BusChoice("vcan", f"vcan links {', '.join(names.values())} are there", names)
