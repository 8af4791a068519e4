"""Frames that nobody should send, to the drives and to the controller, in every state of a run."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import ERR_FLAG, FD_FRAME_SIZE, FD_LENGTHS, FDF, RTR_FLAG, Frames
from dftc_rt.bus.inprocess import InProcessSocket
from dftc_rt.cli.session import Session
from dftc_rt.control import signals
from dftc_rt.controller import connect
from dftc_rt.drives.wiring import frame_size
from dftc_rt.errors import DftcError
from dftc_rt.log.run import split
from dftc_rt.memory import MemorySink
from dftc_rt.rt.clock import LockstepClock
from dftc_rt.rt.executor import Executor
from dftc_rt.rt.supervisor import State
from hil.drive import slots
from hil.simulate import in_process_rig
from tests.fuzz.limits import HangsError, bounded, one_line

STATES = (None, State.ARM, State.RUN, State.DEGRADED, State.FINISH, State.SAFE_STOP, State.FAULT)
"""When frames are made up: in set-up (None), or in one state of the executor."""
_SEEN = 512  # frames that are kept to be changed
_BARRIER_LOW = 0x1FFF_FFFE


def settings(profile: str) -> list[str]:
    """Overrides of the scenario of :mod:`tests.fuzz.files` for a run with made-up frames."""
    return [
        f"bus.profile={profile}", "control.law=computed_torque", "rig.plant.q0_rad=[0.5, 0.3]",
        "duration_s=0.03", "bus.overload=allow", "supervisor.brake_s=0.005",
    ]  # fmt: skip


class Forger:
    """Makes frames up: of noise, of identifiers that mean something, and of frames that passed."""

    def __init__(self, seed: int, size: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.size = size
        self.made = 0
        self._seen = np.zeros((_SEEN, size), dtype=np.uint8)
        self._count = 0

    def watch(self, frames: Frames, count: int) -> None:
        """Remember frames that passed."""
        for row in range(count):
            if (int(frames[row, :4].view("<u4")[0]) & 0x1FFF_FFFF) != _BARRIER_LOW:
                self._seen[self._count % _SEEN] = frames[row]
                self._count += 1

    def make(self, count: int) -> Frames:
        """Return so many frames, none of which is a barrier."""
        rng, size = self.rng, self.size
        known = min(self._count, _SEEN)
        out = rng.integers(0, 256, (count, size), dtype=np.uint8)
        heads = out[:, :4].copy().view("<u4")[:, 0]
        kind = rng.integers(0, 8, count)
        heads[kind < 4] &= 0x7FF
        heads[kind == 1] = rng.choice(_identifiers(), int((kind == 1).sum()))
        heads[kind == 2] |= rng.choice((ERR_FLAG, RTR_FLAG), int((kind == 2).sum())).astype("<u4")
        lengths = rng.integers(0, 9, count)
        if size == FD_FRAME_SIZE:
            lengths = rng.choice(FD_LENGTHS, count)
            out[:, 5] = rng.choice((0, FDF, FDF | 1), count)
        out[:, 4] = lengths
        out[:, :4] = heads[:, None].view(np.uint8)
        if known:
            copied = kind >= 5
            out[copied] = self._seen[rng.integers(0, known, int(copied.sum()))]
            flip = copied & (rng.random(count) < 0.8)
            at = rng.integers(8, min(size, 24) if size > 16 else 16, count)
            out[np.flatnonzero(flip), at[flip]] ^= 1 << rng.integers(0, 8, int(flip.sum())).astype(
                np.uint8
            )
            short = copied & (rng.random(count) < 0.1)
            out[short, 4] = rng.integers(0, 9, int(short.sum()))
        ids = out[:, :4].copy().view("<u4")[:, 0]
        out[(ids & 0x1FFF_FFFF) == _BARRIER_LOW, 0] = 0
        self.made += count
        return out


def _identifiers() -> NDArray[np.uint32]:
    """What a CiA 402, MIT or moteus drive with node id 1 or 2 listens to or sends, and SYNC."""
    found = [0x000, 0x080, 0x100, 0x8001, 0x8002, 0x0100, 0x0200, 0x001, 0x002]
    for base in range(0x080, 0x780, 0x080):
        found += [base | 1, base | 2, base | 0x7F]
    return np.array(found, dtype=np.uint32)


class ForgedSocket:
    """A socket of the controller's; made-up frames come, or go, before the real ones."""

    def __init__(
        self, inner: InProcessSocket, forger: Forger, run: ForgedRun, check: Callable[[], None]
    ) -> None:
        self.inner, self.forger, self.run, self.check = inner, forger, run, check
        self.name, self.fd = inner.name, inner.fd

    def send(self, frames: Frames, count: int) -> int:
        self.forger.watch(frames, count)
        if self.run.forging and not self.run.to_controller:
            made = self.forger.make(self.run.burst)
            # Past the service: the drives find them in front of what the controller sends.
            peer = self.inner._peer
            assert peer is not None
            peer._inbox.push(made, len(made))
        sent = self.inner.send(frames, count)
        self.check()
        return sent

    def receive(self, frames: Frames) -> int:
        count = self.inner.receive(frames)
        self.forger.watch(frames, count)
        if not (self.run.forging and self.run.to_controller and count):
            return count
        room = min(self.run.burst, len(frames) - count)
        frames[room : room + count] = frames[:count].copy()
        frames[:room] = self.forger.make(room)
        return count + room

    def set_filters(self, filters: Any) -> None:
        self.inner.set_filters(filters)

    def close(self) -> None:
        self.inner.close()


class Losing:
    """A law that says of its first joint that it has lost torque."""

    def __init__(self, law: Any) -> None:
        self._law = law

    def __getattr__(self, name: str) -> Any:
        return getattr(self._law, name)

    def update(self, rec: NDArray[np.float64], *terms: Any) -> int:
        status: int = self._law.update(rec, *terms)
        rec[signals.VERDICT, 0] = signals.ACTUATOR_LOSS
        rec[signals.RHO_HAT, 0] = 0.9
        return status


@dataclass
class ForgedRun:
    """One run with frames made up in one state.

    Attributes:
        when: The state; None for set-up.
        to_controller: Whether they go to the controller; else to the drives.
        burst: How many at a time.
        executor: The loop, once there is one.
        states: Cycles by state.
        outcome: How it ended.
        made: Frames made up.
    """

    when: State | None
    to_controller: bool
    burst: int
    executor: Executor | None = None
    states: Counter[int] = field(default_factory=Counter)
    outcome: str = ""
    made: int = 0

    @property
    def forging(self) -> bool:
        """Whether frames are made up now."""
        if self.executor is None:
            return self.when is None
        return self.when is not None and self.executor._state is self.when


def campaign(
    opened: Callable[[str], Session], seeds: range, bursts: tuple[int, ...]
) -> Iterator[tuple[str, ForgedRun | BaseException, int]]:
    """Yield profile, what became of it, and the seed, for every state, direction and seed."""
    for seed in seeds:
        for profile in ("cia402", "mit", "moteus"):
            session = opened(profile)
            for when in STATES:
                for to_controller in (True, False):
                    run = ForgedRun(when, to_controller, bursts[seed % len(bursts)])
                    try:
                        yield profile, forged_run(session, run, seed), seed
                    except (Exception, HangsError) as error:
                        yield profile, error, seed


def forged_run(opened: Session, run: ForgedRun, seed: int) -> ForgedRun:
    """Run a session with made-up frames, and check what must hold whatever they are.

    Raises:
        AssertionError: A torque above a limit, or a state that is none.
    """
    scenario = opened.scenario
    if run.when is State.SAFE_STOP:
        tight = msgspec.structs.replace(scenario.supervisor, tracking_error_rad=2e-4)
        scenario = msgspec.structs.replace(scenario, supervisor=tight)
    opened = dataclasses.replace(opened, scenario=scenario)
    limit = opened.parts.torque_limit
    cycles, truth = MemorySink(opened.cycle.size), MemorySink(opened.rig.size)
    motion = np.empty((3, opened.robot.n))
    opened.parts.reference.target(0.0, motion)
    joined = in_process_rig(scenario, opened.robot, motion, truth, lambda *_: None)
    forger = Forger(seed, frame_size(scenario.bus))
    objects = joined.rig.drives.objects

    def check_drives() -> None:
        followed, most = np.abs(objects[:, slots.COMMAND]), objects[:, slots.MAX_TORQUE]
        assert np.all(followed <= most), "a drive follows more than it may"

    sockets = [ForgedSocket(socket, forger, run, check_drives) for socket in joined.sockets]

    with bounded():
        try:
            run.executor = connect(
                scenario, opened.parts, sockets, LockstepClock(), cycles, lambda *_: None,
                lambda: False,
            )  # fmt: skip
            if run.when is State.DEGRADED:
                run.executor._law = Losing(run.executor._law)
            run.outcome = run.executor.run().end_state
            assert run.executor._state is State.IDLE
        except DftcError as error:
            one_line(error)
            run.outcome = type(error).__name__
    run.made = forger.made
    signals_ = split(opened.cycle, cycles.records())
    run.states.update(signals_["state"].astype(int).tolist())
    assert np.all(np.isfinite(signals_["tau_cmd"])), "a torque that is not finite"
    assert np.all(np.abs(signals_["tau_cmd"]) <= limit + 1e-9), "more than the limit on the wire"
    torque = truth.records()[:, 1 + 2 * opened.robot.n : 1 + 3 * opened.robot.n]
    assert np.all(np.abs(torque) <= 1.001 * limit + 1e-9), "the plant got more than the limit"
    return run
