"""One run from the several files that it is in when its recorder had to be started again.

A recorder that was killed leaves a torn file; the next one goes on in another, where the
first had stopped releasing records. So a few may be in both files, and those that the
first had not yet flushed are in neither. One that begins after the controller's end has the
truth alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dftc_rt.errors import LogError
from dftc_rt.log.reader import is_torn, read_piece
from dftc_rt.log.run import Run, Signals


def read_pieces(paths: Sequence[Path]) -> tuple[Run, str]:
    """The run that is in these files, as far as they can be read.

    Args:
        paths: In the order in which they were written.

    Returns:
        The run, and a line that says what it was put together from; "" for one whole file.

    Raises:
        LogError: None of them can be read, or has a ``/cycle``.
    """
    runs: list[Run] = []
    notes: list[str] = []
    errors: list[LogError] = []
    for path in paths:
        try:
            runs.append(read_piece(path, torn=True))
        except LogError as error:
            errors.append(error)
            notes.append(f"nothing in {path}")
        else:
            if is_torn(path):
                notes.append(f"{path} up to its tear")
    if not any(run.cycle for run in runs):
        raise errors[0] if errors else LogError(str(paths[0]), "no topic /cycle", "a run's log")
    if len(paths) > 1:
        notes.insert(0, f"{len(runs)} of {len(paths)} files")
    note = f"the summary is made of {', '.join(notes)}" if notes else ""
    return (runs[0] if len(runs) == 1 else _joined(runs)), note


def _joined(runs: Sequence[Run]) -> Run:
    rigs = [run.rig for run in runs if run.rig is not None]
    events = [event for run in runs for event in run.events]
    return dataclasses.replace(
        runs[0],
        cycle=_concatenated([run.cycle for run in runs if run.cycle]),
        rig=_concatenated(rigs) if rigs else None,
        events=tuple(sorted(dict.fromkeys(events), key=lambda event: event.t)),
    )


def _concatenated(pieces: Sequence[Signals]) -> Signals:
    """One after the other; of records with the same time, the first."""
    _, kept = np.unique(np.concatenate([piece["t"] for piece in pieces]), return_index=True)
    return {name: np.concatenate([piece[name] for piece in pieces])[kept] for name in pieces[0]}
