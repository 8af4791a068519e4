"""A run as arrays: what analysis works on, from a log or straight from memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from dftc_rt.errors import EnvironmentLacksError, InputError
from dftc_rt.log.schema import Layout, field_name, rig_layout
from dftc_rt.ring import Event

Signals = dict[str, NDArray[np.float64]]
"""Field → shape (K,) for header fields, (K, n) for per-joint rows; units as in the schema."""


@dataclass(frozen=True)
class CanFrames:
    """Every frame that the controller sent or received, K of them, in that order.

    Attributes:
        buses: Logical bus names.
        records: Shape (K,), fields ``t`` (s), ``id`` (with flags), ``bus`` (index), ``tx``
            (sent by the controller), ``flags`` (of CAN FD), ``length``, ``data`` (8 or 64
            bytes): :func:`dftc_rt.bus.frame_record.record_dtype`.
    """

    buses: tuple[str, ...]
    records: NDArray[np.void]


@dataclass(frozen=True)
class Run:
    """One run, K cycles of n joints.

    Attributes:
        joints: Joint names in column order.
        cycle: What the controller knew.
        rig: What was true, on the rig's own time axis; None without a rig.
        events: In order of time.
        scenario: Resolved scenario, TOML ("" when unknown).
        urdf: The robot ("" when unknown).
        torque_limit: What commands are held to, n of them, Nm; None when unknown.
        metadata: Metadata records by name, e.g. ``versions``.
        can: Every frame; None when they were not logged, or not asked for.
        attachments: Attached files by name, besides scenario and URDF.
    """

    joints: tuple[str, ...]
    cycle: Signals
    rig: Signals | None = None
    events: tuple[Event, ...] = ()
    scenario: str = ""
    urdf: str = ""
    torque_limit: tuple[float, ...] | None = None
    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    can: CanFrames | None = None
    attachments: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def epoch_ns(self) -> int:
        """Unix time of t = 0, ns; 0 in lock-step."""
        return int(self.metadata.get("dftc_rt", {}).get("epoch_ns", "0"))

    def columns(self, topic: str = "/cycle") -> dict[str, NDArray[Any]]:
        """The fields of a topic by name, as the log has them: ``q_panda_joint1``.

        Args:
            topic: ``/cycle``, ``/rig`` or ``/can``.

        Returns:
            Field -> shape (K,); of ``/can``, ``data`` has shape (K, 8) or (K, 64).

        Raises:
            InputError: The run does not have the topic.
        """
        signals = {"/cycle": self.cycle, "/rig": self.rig}.get(topic)
        if topic == "/can" and self.can is not None:
            records = self.can.records
            return {name: records[name] for name in records.dtype.names or ()}
        if signals is None:
            raise InputError(topic, "not in this run", "/cycle, or /rig or /can where logged")
        found: dict[str, NDArray[Any]] = {}
        for name, values in signals.items():
            if values.ndim == 1:
                found[name] = values
                continue
            for i, joint in enumerate(self.joints):
                found[f"{name}_{field_name(joint)}"] = values[:, i]
        return found

    def frame(self, topic: str = "/cycle") -> Any:
        """A topic as a pandas ``DataFrame`` with the index ``t``, s.

        In that of ``/can``, ``bus`` is the bus's name and ``data`` the bytes that count.

        Args:
            topic: ``/cycle``, ``/rig`` or ``/can``.

        Raises:
            InputError: The run does not have the topic.
            EnvironmentLacksError: pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise EnvironmentLacksError(
                "pandas is not installed", "pip install 'dftc_rt[tables]'"
            ) from None
        columns: dict[str, Any] = self.columns(topic)
        if topic == "/can" and self.can is not None:
            columns["bus"] = np.array(self.can.buses)[columns["bus"]]
            rows = zip(columns["data"], columns["length"].tolist(), strict=True)
            columns["data"] = [row[:length].tobytes() for row, length in rows]
        return pd.DataFrame(columns).set_index("t")

    @classmethod
    def from_records(
        cls,
        layout: Layout,
        cycle: NDArray[np.float64],
        rig: NDArray[np.float64] | None = None,
        *,
        scenario: str = "",
        events: Sequence[Event] = (),
        torque_limit: Sequence[float] | NDArray[np.float64] | None = None,
    ) -> Self:
        """A run from in-memory records, as the rings carry them.

        Args:
            layout: Layout of ``/cycle``.
            cycle: Records, shape ``(K, layout.size)``.
            rig: Records of ``/rig``, shape ``(K', rig_layout(joints).size)``.
            scenario: Resolved scenario, TOML.
            events: What happened.
            torque_limit: Shape ``(n,)``, Nm.

        Raises:
            InputError: Records of another width than the layout's.
        """
        truth = None if rig is None else split(rig_layout(layout.joints), rig)
        limit = None if torque_limit is None else tuple(float(x) for x in torque_limit)
        return cls(
            layout.joints,
            split(layout, cycle),
            truth,
            tuple(events),
            scenario,
            torque_limit=limit,
        )


def split(layout: Layout, records: NDArray[np.float64]) -> Signals:
    """Views of records by name; no copy.

    Args:
        layout: What the columns are.
        records: Shape ``(K, layout.size)``.

    Raises:
        InputError: Records of another width.
    """
    if records.ndim != 2 or records.shape[1] != layout.size:
        raise InputError(layout.topic, f"records of shape {records.shape}", f"(K, {layout.size})")
    signals: Signals = {name: records[:, i] for i, name in enumerate(layout.header)}
    at, n = len(layout.header), len(layout.joints)
    for row in layout.rows:
        signals[row] = records[:, at : at + n]
        at += n
    return signals
