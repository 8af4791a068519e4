"""Decentralised fault-tolerant control for any robot that a URDF describes.

Source: [zhao2017].
"""

from __future__ import annotations

import os
import shutil
import sys
import zlib
from pathlib import Path
from typing import Final

_KEPT: Final = 4  # revisions whose kernels stay: other processes may be starting with them


def _kernel_cache() -> None:
    """Give compiled kernels a folder of their own for every revision of the sources.

    numba looks for a change in the file of a kernel alone. One that calls a function of another
    file would go on running that function as it was, after an edit or an upgrade.
    """
    package = Path(__file__).resolve().parent
    revision = 0
    for folder in (package, package.parent / "hil"):
        for path in sorted(folder.rglob("*.py")):
            revision = zlib.crc32(path.read_bytes(), revision)
    name = f"numba-{revision:08x}"
    given = os.environ.get("NUMBA_CACHE_DIR", "")
    if given.endswith(name):
        return  # from the process that started this one
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dftc_rt"
    for base in (Path(given),) if given else (package / "__pycache__", home):
        place = base / name
        try:
            place.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(place, os.W_OK):
            os.utime(place)
            _forget(base)
            os.environ["NUMBA_CACHE_DIR"] = str(place)
            if "numba" in sys.modules:
                sys.modules["numba"].config.CACHE_DIR = str(place)
            return


def _forget(base: Path) -> None:
    """Remove the kernels of all revisions but the latest few."""
    found = sorted(base.glob("numba-*"), key=_age, reverse=True)
    for old in found[_KEPT:]:
        shutil.rmtree(old, ignore_errors=True)


def _age(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:  # another process was faster
        return 0.0


_kernel_cache()
