"""Made-up frames to the drives and the controller, in every state: all ends in order.

More of them: ``python -m tests.benchmarks fuzz``.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from dftc_rt.bus.frame import frame_buffer, pack
from dftc_rt.cli.session import Session, open_session
from dftc_rt.drives.cia402.network import SocketNetwork
from dftc_rt.rt.supervisor import State
from tests.fuzz import wire
from tests.fuzz.files import SCENARIO, write

PROFILES = ("cia402", "mit", "moteus")


@pytest.fixture(scope="module", params=PROFILES)
def opened(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Session:
    path = write(tmp_path_factory.mktemp("wire") / "s.toml", SCENARIO.encode())
    return open_session(path, wire.settings(request.param))


@pytest.mark.parametrize("to_controller", [True, False], ids=["to controller", "to drives"])
@pytest.mark.parametrize("when", wire.STATES, ids=lambda when: when.name if when else "SET_UP")
def test_it_goes_on_or_ends_in_order(
    opened: Session, when: State | None, to_controller: bool
) -> None:
    for seed, burst in enumerate((3, 40)):
        run = wire.forged_run(opened, wire.ForgedRun(when, to_controller, burst), seed)
        assert run.made > 0, "the state never came, or nothing passed in it"
        if when is not None:
            assert run.states[int(when)] > 0


class Canned:
    """A socket that holds some frames."""

    name, fd = "can0", -1

    def __init__(self, *frames: tuple[int, bytes]) -> None:
        self._frames: Iterator[tuple[int, bytes]] = iter(frames)

    def receive(self, frames: object) -> int:
        buffer = frame_buffer(1)
        for can_id, data in self._frames:
            buffer[0] = list(pack(can_id, data))
            frames[0] = buffer[0]  # type: ignore[index]
            return 1
        return 0


@pytest.mark.parametrize(
    ("can_id", "data"),
    [
        (0x701, b"\x30"),  # an NMT state that is none: KeyError in canopen
        (0x081, b"\x01\x02"),  # half an emergency: struct.error
        (0x701, b""),
        (0x581, b""),  # an SDO answer of no bytes
        (0x000, b""),
    ],
)
def test_set_up_leaves_out_what_canopen_cannot_parse(can_id: int, data: bytes) -> None:
    from dftc_rt.drives.cia402.network import PumpedNode

    network = SocketNetwork(Canned((can_id, data)), 0.1)  # type: ignore[arg-type]
    network.add_node(PumpedNode(1, _dictionary()))
    assert network.pump() == 1


def _dictionary() -> object:
    from dftc_rt.drives.cia402.eds import dictionary

    return dictionary(1)


def test_forged_frames_are_never_the_barrier(tmp_path: Path) -> None:
    forger = wire.Forger(3, 16)
    ids = forger.make(20_000)[:, :4].copy().view("<u4")[:, 0]
    assert ((ids & 0x1FFF_FFFF) != 0x1FFF_FFFE).all()
    assert len(set((ids >> 29).tolist())) == 8  # standard, extended, remote, error
