"""vcan links made and removed on a kernel that is played. The real one: tests/integration."""

from __future__ import annotations

import errno
import os

import pytest

from dftc_rt.bus import link_kind, vcan_links
from dftc_rt.bus.rtnetlink import Link, find_link
from dftc_rt.bus.vcan_links import bring_up, take_down
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

    def delete(self, link: Link) -> None:
        (name,) = (name for name, each in self.links.items() if each == link)
        self.changes.append(f"delete {link.index}")
        del self.links[name]


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    played = Kernel({"vcan1": Link(3, "vcan", False), "vcan2": Link(4, "vcan", True),
                     "vcan7": Link(5, "vxcan", True), "vcan8": Link(6, "", True)})  # fmt: skip
    monkeypatch.setattr(link_kind, "find_link", played.find)
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
