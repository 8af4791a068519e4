"""Which bus a rig runs on. The kernel's part is checked in test_buses_vcan."""

from __future__ import annotations

import pytest

from dftc_rt.bus.link_kind import link_kind
from dftc_rt.bus.select import BusChoice, choose_bus
from dftc_rt.errors import EnvironmentLacksError, InputError

KINDS = {"vcan0": "vcan", "vcan1": "vcan", "vcan2": "slcan", "vcan3": "", "can9": "vcan"}


def test_auto_takes_vcan_when_every_bus_has_one() -> None:
    choice = choose_bus("auto", ["can0", "can1"], KINDS.get)
    assert choice.kind == "vcan"
    assert choice.interfaces == {"can0": "vcan0", "can1": "vcan1"}
    assert "\n" not in choice.reason


@pytest.mark.parametrize(
    ("bus", "found"), [("can2", "slcan"), ("can3", "hardware"), ("can9", "missing")]
)
def test_auto_falls_back_to_the_user_space_bus_and_says_why(bus: str, found: str) -> None:
    choice = choose_bus("auto", ["can0", bus], KINDS.get)
    assert choice.kind == "unix"
    assert not choice.interfaces
    assert found in choice.reason


def test_auto_without_rtnetlink_is_the_user_space_bus() -> None:
    def refuse(interface: str) -> str:
        raise EnvironmentLacksError("no netlink here", "get one")

    assert choose_bus("auto", ["can0"], refuse) == BusChoice(
        "unix", "user-space bus: no netlink here"
    )


def test_vcan_asked_for_and_not_there() -> None:
    with pytest.raises(EnvironmentLacksError, match=r"vcan9.*dftc bus up can0,can9"):
        choose_bus("vcan", ["can0", "can9"], KINDS.get)
    with pytest.raises(InputError, match="slcan"):
        choose_bus("vcan", ["can2"], KINDS.get)


@pytest.mark.parametrize("kind", ["unix", "inprocess"])
def test_what_is_asked_for_is_taken(kind: str) -> None:
    assert choose_bus(kind, ["can0"], KINDS.get).kind == kind


@pytest.mark.parametrize("interface", ["socketcan", "can0", "", "python-can:pcan"])
def test_a_real_bus_is_no_choice(interface: str) -> None:
    with pytest.raises(InputError, match=r"bus\.interface"):
        choose_bus(interface, ["can0"], KINDS.get)


def test_the_kernel_knows_the_loopback_and_nothing_of_the_absent() -> None:
    assert link_kind("lo") == ""
    assert link_kind("absent0") is None
    assert link_kind("a-name-too-long-for-a-link") is None
    assert link_kind("") is None
