"""vcan links made and removed on a kernel that is played. The real one: tests/integration."""

from __future__ import annotations

import errno
import os

import pytest

from dftc_rt.bus import link_kind, vcan_links
from dftc_rt.bus.rtnetlink import Link, find_link
from dftc_rt.bus.vcan_links import bring_up, check_fd, take_down
from dftc_rt.errors import EnvironmentLacksError, InputError


class Kernel:
    """Links by name, and the error that the next change meets."""

    def __init__(self, links: dict[str, Link]) -> None:
        self.links = links
        self.refusal = 0
        self.after = 0  # changes that still succeed
        self.changes: list[str] = []

    def find(self, name: str) -> Link | None:
        return self.links.get(name)

    def _change(self, what: str) -> None:
        if self.refusal and not self.after:
            raise OSError(self.refusal, os.strerror(self.refusal))
        self.after -= 1
        self.changes.append(what)

    def add(self, name: str, kind: str) -> None:
        self._change(f"add {name} {kind}")
        self.links[name] = Link(len(self.links) + 10, kind, True)

    def up(self, link: Link) -> None:
        self._change(f"up {link.index}")

    def down(self, link: Link) -> None:
        self._change(f"down {link.index}")

    def resize(self, link: Link, mtu: int) -> None:
        self._change(f"mtu {link.index} {mtu}")

    def delete(self, link: Link) -> None:
        (name,) = (name for name, each in self.links.items() if each == link)
        self.changes.append(f"delete {link.index}")
        del self.links[name]


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    played = Kernel({"vcan1": Link(3, "vcan", False), "vcan2": Link(4, "vcan", True),
                     "vcan7": Link(5, "vxcan", True), "vcan8": Link(6, "", True)})  # fmt: skip
    monkeypatch.setattr(link_kind, "find_link", played.find)
    monkeypatch.setattr(vcan_links, "find_link", played.find)
    monkeypatch.setattr(vcan_links, "set_link_down", played.down)
    monkeypatch.setattr(vcan_links, "set_link_mtu", played.resize)
    monkeypatch.setattr(vcan_links, "add_link", played.add)
    monkeypatch.setattr(vcan_links, "set_link_up", played.up)
    monkeypatch.setattr(vcan_links, "delete_link", played.delete)
    monkeypatch.setattr(vcan_links, "_check_socketcan", lambda: None)
    return played


def test_what_is_missing_is_made_and_what_is_down_brought_up(kernel: Kernel) -> None:
    done = bring_up(["vcan0", "vcan1", "vcan2"])
    assert done == {"vcan0": "made", "vcan1": "brought up", "vcan2": "was up"}
    assert kernel.changes == ["add vcan0 vcan", "up 3"]


def test_what_is_there_is_removed(kernel: Kernel) -> None:
    assert take_down(["vcan0", "vcan1"]) == {"vcan0": "was not there", "vcan1": "removed"}
    assert kernel.changes == ["delete 3"]


@pytest.mark.parametrize("change", [bring_up, take_down])
@pytest.mark.parametrize(("name", "found"), [("vcan7", "vxcan"), ("vcan8", "hardware")])
def test_a_link_of_another_kind_is_left_alone_and_so_are_all(
    kernel: Kernel, change: object, name: str, found: str
) -> None:
    assert callable(change)
    with pytest.raises(InputError, match=f"{name}: a link of kind {found}"):
        change(["vcan0", "vcan2", name])
    assert kernel.changes == []


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.EPERM, "not permitted to make vcan5; run this as root"),
        (errno.EOPNOTSUPP, "no vcan.*modprobe vcan"),
        (errno.ENOBUFS, os.strerror(errno.ENOBUFS)),
    ],
)
def test_a_refusal_undoes_what_was_made(kernel: Kernel, code: int, words: str) -> None:
    kernel.refusal, kernel.after = code, 1
    with pytest.raises(EnvironmentLacksError, match=words) as caught:
        bring_up(["vcan4", "vcan5"])
    assert "\n" not in str(caught.value)
    assert "--bus unix" in str(caught.value)
    assert kernel.changes == ["add vcan4 vcan", "delete 14"]


def test_a_name_that_no_link_can_have(kernel: Kernel) -> None:
    with pytest.raises(InputError, match="15 characters"):
        bring_up(["vcan-of-the-left-arm"])
    assert kernel.changes == []


def test_the_kernel_tells_the_loopback() -> None:
    lo = find_link("lo")
    assert lo is not None
    assert (lo.index, lo.kind) == (1, "")
    assert find_link("absent0") is None


def test_links_for_can_fd_get_its_mtu_and_only_they_go_down_for_it(kernel: Kernel) -> None:
    kernel.links = {
        "vcan1": Link(3, "vcan", True, 16), "vcan2": Link(4, "vcan", False, 16),
        "vcan3": Link(5, "vcan", True, 72), "vcan4": Link(6, "vcan", False, 72),
    }  # fmt: skip
    assert bring_up(list(kernel.links), fd=True) == {
        "vcan1": "was up, mtu 16 -> 72",
        "vcan2": "brought up, mtu 16 -> 72",
        "vcan3": "was up",
        "vcan4": "brought up",
    }
    assert kernel.changes == [
        "down 3", "mtu 3 72", "up 3", "mtu 4 72", "up 4", "up 6",
    ]  # fmt: skip


def test_links_of_classical_frames_stay_as_they_are(kernel: Kernel) -> None:
    kernel.links = {"vcan1": Link(3, "vcan", True, 16)}
    assert bring_up(["vcan1"]) == {"vcan1": "was up"}
    assert kernel.changes == []


def test_a_link_of_classical_frames_is_refused_where_they_are_can_fd(kernel: Kernel) -> None:
    kernel.links = {"vcan1": Link(3, "vcan", True, 72), "vcan2": Link(4, "vcan", True, 16)}
    check_fd(["vcan1"], "remedy")
    with pytest.raises(EnvironmentLacksError, match=r"vcan2 .*mtu 16.*; dftc bus up") as caught:
        check_fd(["vcan1", "vcan2"], "dftc bus up SCENARIO")
    assert caught.value.exit_code == 3
