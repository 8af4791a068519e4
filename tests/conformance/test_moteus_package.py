"""The emulated moteus drives against mjbots' own package, over its own transport.

``moteus.PythonCan`` opens our bus through python-can's plug-in mechanism, sends what its
``Controller`` makes, and decodes what comes back; nothing of ours is between but the bus.
"""

from __future__ import annotations

import asyncio
import io
import math
import select
import threading
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import moteus
import numpy as np
import pytest
from moteus import multiplex

from dftc_rt.bus.directory import BusDirectory
from dftc_rt.bus.frame import FD_FRAME_SIZE, frame_buffer, pack_fd, unpack
from dftc_rt.drives.interface import GOAL_OPERATE
from dftc_rt.drives.moteus import codec
from dftc_rt.drives.moteus import registers as reg
from dftc_rt.drives.moteus.client import MoteusClient
from dftc_rt.drives.moteus.cycle import MoteusCycle
from hil.bus.unix import UnixPort, listen
from hil.drive import slots
from hil.drive.moteus import MoteusDrives
from tests.unit.drives.moteus.moteus_bus import bus_of, configs, drives_of, scales

pytestmark = pytest.mark.realtime

Register = moteus.Register

PATIENCE_S = 20.0
TURN = 1 << 20  # encoder counts
FAR = 9  # node id from which on answers have 29 bits: 900h


class Served:
    """Emulated drives on the user-space bus, served by a thread as the rig's loop would."""

    def __init__(self, directory: Path, drives: MoteusDrives) -> None:
        self.drives = drives
        self.claim = BusDirectory(directory)
        listener = listen(self.claim.path, "can0")
        self.port = UnixPort("can0", listener, data_bitrate=5_000_000)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        inbox, out = (frame_buffer(64, FD_FRAME_SIZE) for _ in range(2))
        while not self._end.is_set():
            select.select(self.port.fds(), [], [], 0.01)
            count = self.port.receive(inbox)
            self.drives.receive(0, inbox, 0, count)
            self.port.send(out, self.drives.answer(0, out), self.drives.senders)

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        self.port.close()
        self.claim.release()


@pytest.fixture
def drives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[MoteusDrives]:
    monkeypatch.setenv("DFTC_BUS_DIR", str(tmp_path / "buses"))
    made = drives_of(scales(FAR), per_bus=FAR, watchdog_s=0.5)
    made.objects[0, [slots.POSITION, slots.VELOCITY, slots.TORQUE_ACTUAL]] = (
        TURN // 4, -TURN // 2, 150,
    )  # fmt: skip
    served = Served(tmp_path / "buses", made)
    yield made
    served.close()


def talk(conversation: Callable[[Any], Awaitable[None]], node: int = 1, **options: Any) -> None:
    """Run a conversation with one drive."""

    async def within() -> None:
        transport = moteus.PythonCan(interface="dftc", channel="can0", fd=True)
        try:
            controller = moteus.Controller(id=node, transport=transport, **options)
            await asyncio.wait_for(conversation(controller), PATIENCE_S)
        finally:
            transport.close()

    asyncio.run(within())


def test_query(drives: MoteusDrives) -> None:
    async def conversation(drive: Any) -> None:
        found = await drive.query()
        assert found.id == 1
        assert found.values == {
            Register.MODE: moteus.Mode.STOPPED,
            Register.POSITION: pytest.approx(0.25),
            Register.VELOCITY: pytest.approx(-0.5),
            Register.TORQUE: pytest.approx(1.5),
            Register.VOLTAGE: pytest.approx(24.0),
            Register.TEMPERATURE: pytest.approx(30.0),
            Register.FAULT: 0,
        }

    talk(conversation)


@pytest.mark.parametrize(
    ("form", "position", "velocity", "torque"),
    [
        # of 0.25 rev, −0.5 rev/s and 1.5 Nm whole steps, all of them
        (multiplex.INT8, 0.25, -0.5, 1.5),
        (multiplex.INT16, 0.25, -0.5, 1.5),
        (multiplex.INT32, 0.25, -0.5, 1.5),
        (multiplex.F32, 0.25, -0.5, 1.5),
    ],
)
def test_every_format(
    drives: MoteusDrives, form: int, position: float, velocity: float, torque: float
) -> None:
    class Resolution(moteus.QueryResolution):  # type: ignore[misc]
        pass

    for name in ("mode", "position", "velocity", "torque", "q_current", "power", "fault",
                 "motor_temperature", "trajectory_complete", "voltage", "temperature"):  # fmt: skip
        setattr(Resolution, name, form)

    async def conversation(drive: Any) -> None:
        values = (await drive.query()).values
        assert values[Register.POSITION] == pytest.approx(position)
        assert values[Register.VELOCITY] == pytest.approx(velocity)
        assert values[Register.TORQUE] == pytest.approx(torque)
        assert values[Register.MOTOR_TEMPERATURE] == pytest.approx(30.0)
        assert values[Register.POWER] == 0.0

    talk(conversation, query_resolution=Resolution())


@pytest.mark.parametrize("node", [1, FAR])
@pytest.mark.parametrize("host", [0, 0x21])
def test_torque_by_position_mode(drives: MoteusDrives, node: int, host: int) -> None:
    d = node - 1

    async def conversation(drive: Any) -> None:
        found = await drive.set_position(
            position=math.nan, velocity=0.0, feedforward_torque=-3.21, kp_scale=0.0,
            kd_scale=0.0, maximum_torque=10.0, watchdog_timeout=0.25, query=True,
        )  # fmt: skip
        assert found.id == node
        assert found.values[Register.MODE] == moteus.Mode.POSITION
        assert drives.command[d] == -321
        assert drives.operation_enabled[d] == 1
        assert drives.objects[d, slots.WATCHDOG] == 250_000
        await drive.set_position(
            position=math.nan, feedforward_torque=-30.0, kp_scale=0.0, kd_scale=0.0,
            maximum_torque=10.0, query=True,
        )  # fmt: skip
        assert drives.command[d] == -1000
        assert drives.objects[d, slots.WATCHDOG] == 500_000  # its own again
        found = await drive.set_stop(query=True)
        assert found.values[Register.MODE] == moteus.Mode.STOPPED
        assert drives.command[d] == 0
        assert drives.operation_enabled[d] == 0

    talk(conversation, node, source_can_id=host)


def test_position_mode_with_its_gains(drives: MoteusDrives) -> None:
    async def conversation(drive: Any) -> None:
        # 4 Nm/rev · (0.5 − 0.25) rev + 0.05 Nm s/rev · (1 + 0.5) rev/s = 1.075 Nm
        await drive.set_position(position=0.5, velocity=1.0, query=True)
        assert drives.command[0] in (107, 108)
        # the scale of kd is limited to that of kp: 0.5 · 1.075 Nm
        await drive.set_position(position=0.5, velocity=1.0, kp_scale=0.5, query=True)
        assert drives.command[0] == 54

    talk(conversation)


def test_the_command_reads_back(drives: MoteusDrives) -> None:
    async def conversation(drive: Any) -> None:
        await drive.set_position(
            position=math.nan, feedforward_torque=1.25, kp_scale=0.0, kd_scale=0.0, query=True
        )
        asked = {number: multiplex.F32 for number in range(0x020, 0x028)}
        values = (await drive.custom_query(asked)).values
        assert values == pytest.approx(
            {0x020: math.nan, 0x021: 0.0, 0x022: 1.25, 0x023: 0.0, 0x024: 0.0,
             0x025: math.nan, 0x026: math.nan, 0x027: 0.0}, nan_ok=True,
        )  # fmt: skip

    talk(conversation)


def test_a_command_without_question_is_not_answered(drives: MoteusDrives) -> None:
    async def conversation(drive: Any) -> None:
        assert await drive.set_position(position=math.nan, feedforward_torque=1.0) is None
        found = await drive.query()  # what comes is the answer to this
        assert found.values[Register.MODE] == moteus.Mode.POSITION

    talk(conversation)


def test_fault_is_reported_and_a_stop_clears_it(drives: MoteusDrives) -> None:
    async def conversation(drive: Any) -> None:
        drives.fault(0, 33)
        values = (await drive.query()).values
        assert (values[Register.MODE], values[Register.FAULT]) == (moteus.Mode.FAULT, 33)
        values = (await drive.set_stop(query=True)).values
        assert (values[Register.MODE], values[Register.FAULT]) == (moteus.Mode.FAULT, 33)
        drives.fault(0, 0)
        values = (await drive.set_stop(query=True)).values
        assert (values[Register.MODE], values[Register.FAULT]) == (moteus.Mode.STOPPED, 0)

    talk(conversation)


def test_registers_that_are_not_there_are_errors(drives: MoteusDrives) -> None:
    async def conversation(drive: Any) -> None:
        found = await drive.custom_query({0x001: multiplex.INT16, 0x070: multiplex.INT16})
        parsed = moteus.protocol.parse_registers(found.data)
        assert parsed.response == {0x001: pytest.approx(0.25)}
        assert parsed.errors == [(0x070, 1)]

    talk(conversation)


# --- the controller's frames, read by the package --------------------------------------


def test_what_the_controller_sends_is_what_the_package_reads() -> None:
    sheets = scales(2, timeout=5)
    made = drives_of(sheets)
    bus = bus_of(made)
    cycle = MoteusCycle(configs(sheets), 1, 1000.0)
    cycle.start(MoteusClient([bus], configs(sheets), 1000.0).configure())
    stop = moteus.protocol.parse_registers(bus.sent[0][1])
    assert stop.command == {Register.MODE: moteus.Mode.STOPPED}
    assert [number for number, _ in stop.query] == [0x000, 0x001, 0x002, 0x003, 0x00F]
    cycle.goal = GOAL_OPERATE
    out, inbox = (frame_buffer(8, FD_FRAME_SIZE) for _ in range(2))
    for _ in range(4):
        cycle.begin()
        rows = cycle.sync(0, out)
        bus.send(out, rows)
        cycle.decode(0, inbox, bus.receive(inbox))
        cycle.command(np.array([1.234, -5.0]))
    for row, torque in enumerate((1.23, -5.0)):
        can_id, data = unpack(out[row])
        assert can_id == 0x8000_8001 + row
        found = moteus.protocol.parse_registers(data)
        assert found.command == pytest.approx(
            {0x000: 10, 0x020: math.nan, 0x021: 0.0, 0x022: torque, 0x023: 0.0, 0x024: 0.0,
             0x027: 0.05}, nan_ok=True,
        )  # fmt: skip
        assert found.query == [
            (0x000, multiplex.INT8), (0x001, multiplex.F32), (0x002, multiplex.INT16),
            (0x003, multiplex.INT16),
        ]  # fmt: skip
        assert not found.errors


def test_what_the_package_writes_is_what_the_controller_reads() -> None:
    """Replies put together with the package's own writer, in every format."""
    for form in (reg.INT8, reg.INT16, reg.INT32, reg.FLOAT):
        buffer = io.BytesIO()
        writer = moteus.protocol.Writer(buffer)
        combiner = multiplex.WriteCombiner(writer, 0x20, 0, [form] * 4)
        for write, value in (
            (writer.write_int, 10), (writer.write_position, 0.25), (writer.write_velocity, -0.5),
            (writer.write_torque, 1.5),
        ):  # fmt: skip
            assert combiner.maybe_write()
            write(value, form)
        data = buffer.getvalue()
        row = frame_buffer(1, FD_FRAME_SIZE)
        row[0] = np.frombuffer(pack_fd(0x100, data), dtype=np.uint8)
        found = np.zeros(5)
        assert codec.decode_answer(row[0, 8:], len(data), found)
        # The package cuts integers off: 0.25 / 1e-5 is a little less than 25000.
        assert found == pytest.approx([10, 0.25, -0.5, 1.5, math.nan], abs=1.01e-5, nan_ok=True)
