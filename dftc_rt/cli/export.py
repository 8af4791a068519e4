"""``dftc export``: a log as files of other programs."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dftc_rt.analysis import tables, viewer_layouts
from dftc_rt.bus import can_files
from dftc_rt.cli.frames import logged_frames
from dftc_rt.cli.output import check_output
from dftc_rt.errors import DftcError, InputError, LogError
from dftc_rt.log.reader import read

_LAYOUTS = {
    "foxglove": viewer_layouts.foxglove_layout,
    "plotjuggler": viewer_layouts.plotjuggler_layout,
}
_SUFFIXES = {
    **{form: f".{form}" for form in tables.FORMATS},
    **can_files.SUFFIXES,
    "foxglove": ".json",
    "plotjuggler": ".xml",
}


def export(
    log: str | Path,
    *,
    output: Annotated[str | Path, Parameter(alias="-o")],
    to: str | None = None,
) -> int:
    """Write the signals of a log as a table, its frames as a file of other CAN tools, or a layout.

    Signals: ``parquet``, ``csv`` (a file of /cycle, and one of /rig beside it, F-rig.csv),
    ``npz``. Frames, of a log that was recorded with ``--frames``: ``candump`` (.log), ``asc``,
    ``blf``, ``trc``, ``can-csv`` (.csv), ``txt``, by python-can's writers.
    Layouts for viewers that fit the log's joints: ``foxglove`` (.json), ``plotjuggler`` (.xml).
    Without ``--to``, the file's ending says which; .csv are signals.

    Example::

        dftc export run.mcap -o run.parquet
        dftc export run.mcap --to candump -o run.log

    Args:
        log: The log.
        output: The file to write.
        to: Format; default: by the file's ending.

    Returns:
        Exit code 0.

    Raises:
        LogError: The log cannot be read, or has no frames.
        InputError: The format is not known or not that of the file's ending, or cannot hold
            what is in the log, or the file cannot be written.
        EnvironmentLacksError: A library that the format needs is not installed.
    """
    path = Path(output)
    form = _format(path, to)
    if os.path.exists(log) and os.path.exists(path) and os.path.samefile(log, path):
        raise LogError(str(path), "the log itself", "another file to write to")
    check_output(path)
    try:
        written = _writer(form)(log, form, path)
    except DftcError:
        raise
    except OSError as error:
        raise InputError(str(path), f"cannot be written: {error.strerror or error}") from None
    sys.stdout.write("".join(f"{each}\n" for each in written))
    return 0


def _writer(form: str) -> Callable[[str | Path, str, Path], list[Path]]:
    if form in _LAYOUTS:
        return _layout
    return _signals if form in tables.FORMATS else _frames


def _format(path: Path, to: str | None) -> str:
    """Return the format to write.

    Raises:
        InputError: It is not known, or the file's ending is that of another.
    """
    if to is None:
        found = next((form for form, suffix in _SUFFIXES.items() if suffix == path.suffix), None)
        if found is None:
            endings = ", ".join(dict.fromkeys(_SUFFIXES.values()))
            raise InputError(str(path), f"an ending '{path.suffix}' of no format", endings)
        return found
    if to not in _SUFFIXES:
        raise InputError("--to", f"'{to}'", ", ".join(_SUFFIXES))
    if path.suffix != _SUFFIXES[to]:
        raise InputError(str(path), f"an ending '{path.suffix}'", f"'{_SUFFIXES[to]}' of {to}")
    return to


def _signals(log: str | Path, form: str, path: Path) -> list[Path]:
    tables.require(form)
    run = read(log)
    for each in tables.table_paths(run, form, path).values():
        check_output(each)
    return tables.write_tables(run, form, path)


def _layout(log: str | Path, form: str, path: Path) -> list[Path]:
    path.write_text(_LAYOUTS[form](read(log).joints))
    return [path]


def _frames(log: str | Path, form: str, path: Path) -> list[Path]:
    run = read(log, frames=True)
    can = logged_frames(run, str(log))
    can_files.check_frames(form, can.records)
    can_files.write_can_file(path, form, can.records, can.buses, 1e-9 * run.epoch_ns)
    return [path]
