"""A run as arrays: what analysis works on, from a log or straight from memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dftc_rt.errors import InputError
from dftc_rt.log.schema import Layout, rig_layout
from dftc_rt.ring import Event

Signals = dict[str, NDArray[np.float64]]
"""Field → shape (K,) for header fields, (K, n) for per-joint rows; units as in the schema."""


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
    attachments: Mapping[str, bytes] = field(default_factory=dict)

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
