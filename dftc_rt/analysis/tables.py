"""The signals of a run as tables for other programs: Parquet, CSV, NumPy's npz."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.errors import EnvironmentLacksError
from dftc_rt.log.run import Run

FORMATS: Final = ("parquet", "csv", "npz")
_EXACT: Final = "%.17g"  # reads back as the same number


def table_paths(run: Run, form: str, path: Path) -> dict[str, Path]:
    """Return topic -> file: two of a Parquet or CSV, whose rig has a time axis of its own.

    Args:
        run: The run.
        form: One of :data:`FORMATS`.
        path: As the user named it; that of the rig gets ``-rig`` before its ending.
    """
    topics = ["/cycle"] if run.rig is None else ["/cycle", "/rig"]
    if form == "npz":
        return dict.fromkeys(topics, path)
    return {
        topic: path if topic == "/cycle" else path.with_name(f"{path.stem}-rig{path.suffix}")
        for topic in topics
    }


def require(form: str) -> None:
    """Refuse a format whose library is not installed.

    Raises:
        EnvironmentLacksError: pyarrow is missing.
    """
    if form == "parquet":
        try:
            import pyarrow.parquet  # noqa: F401
        except ImportError:
            raise EnvironmentLacksError(
                "pyarrow is not installed", "pip install 'dftc_rt[tables]'"
            ) from None


def write_tables(run: Run, form: str, path: Path) -> list[Path]:
    """Write ``/cycle`` and ``/rig``; return the files.

    Args:
        run: The run.
        form: One of :data:`FORMATS`.
        path: File to write.

    Raises:
        EnvironmentLacksError: pyarrow is missing.
        OSError: A file cannot be written.
    """
    require(form)
    paths = table_paths(run, form, path)
    tables = {topic: run.columns(topic) for topic in paths}
    if form == "npz":
        named = {f"{t[1:]}/{name}": v for t, table in tables.items() for name, v in table.items()}
        with path.open("wb") as out:
            np.savez(out, allow_pickle=False, **named)
    else:
        for topic, table in tables.items():
            (_write_parquet if form == "parquet" else _write_csv)(table, paths[topic])
    return list(dict.fromkeys(paths.values()))


def _write_parquet(table: dict[str, NDArray[Any]], path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {name: np.ascontiguousarray(values) for name, values in table.items()}
    pq.write_table(pa.table(columns), path)


def _write_csv(table: dict[str, NDArray[Any]], path: Path) -> None:
    header = ",".join(table)
    np.savetxt(
        path, np.stack(list(table.values()), axis=1), _EXACT, ",", header=header, comments=""
    )
