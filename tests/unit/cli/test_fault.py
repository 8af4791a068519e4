"""``dftc fault``: what is sent to the rig, and what is said when it cannot be."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from dftc_rt.cli.main import run
from dftc_rt.config.faults import Fault, LossFault
from hil.fault_desk import FaultDesk


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[list[Fault]]:
    """A desk that is served at 3 s of rig time; the faults that it has."""
    tmp_path.chmod(0o700)
    faults: list[Fault] = []

    def change(new: object) -> None:
        assert isinstance(new, list)
        faults[:] = new

    desk = FaultDesk(tmp_path, [], change, lambda *event: None)
    ended = threading.Event()

    def serve() -> None:
        while not ended.wait(0.001):
            desk.take(3.0)

    server = threading.Thread(target=serve)
    server.start()
    yield faults
    ended.set()
    server.join()
    desk.close()


def test_a_fault_begins_now_and_ends_when_it_is_cleared(
    rig: list[Fault], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = ["--bus-dir", str(tmp_path)]
    table = '{joint="a", kind="loss", effectiveness=0.6, end_s=2.0}'
    assert run(["fault", "apply", table, *place]) == 0
    assert capsys.readouterr().out == "t 3.000 s: loss on a from 3.000 s\n"
    assert rig == [LossFault(joint="a", effectiveness=0.6, start_s=3.0, end_s=5.0)]
    assert run(["fault", "clear", "--joint", "a", "--json", *place]) == 0
    assert json.loads(capsys.readouterr().out) == {"t": 3.0, "text": "ended: loss on a"}
    assert rig == []  # cleared before its first step was over
    assert run(["fault", "clear", *place]) == 2
    assert capsys.readouterr().err.startswith("dftc: fault: clear: no such fault is active")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("0.6", "fault: '0.6'"),
        ('{joint="a", kind="loss"}', "effectiveness"),
        ('{joint="a", kind="loss", effectiveness=2.0}', "fault.effectiveness: found 2.0"),
        ('{bus="can0", kind="frame_loss", probability=0.5}', "frame_loss"),
        ('{joint="a", kind="loss", effectiveness=nan}', "nan"),
    ],
)
def test_what_is_no_fault_is_one_line(
    table: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["fault", "apply", table, "--bus-dir", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert err.startswith("dftc: fault")
    assert said in err
    assert err.count("\n") == 1


def test_no_rig_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tmp_path.chmod(0o700)
    assert run(["fault", "clear", "--bus-dir", str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        f"dftc: {tmp_path}/faults@rig: No such file or directory "
        "(expected the directory that dftc hil or dftc rig has printed)\n"
    )
