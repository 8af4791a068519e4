"""Strict NPZ: an archive becomes the arrays that it has to hold, or one line says what is wrong.

An NPZ may carry pickles, which run code when they are read, and sizes that exhaust the memory. Each
member's header is checked before its values are looked at, and nothing is unpickled.
"""

from __future__ import annotations

import io
import math
import stat
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.errors import InputError, MissingFileError

MOST_BYTES: Final = 64 << 20
"""Largest file, and largest sum of its members."""
_MOST_HEADER: Final = 10_000
_MOST_ITEM: Final = 40_000
_WORDS: Final = {"iu": "integers", "U": "text", "f": "real numbers", "b": "booleans"}
_METHODS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_DAMAGED: Final = (
    ValueError, TypeError, OverflowError, EOFError, RuntimeError, NotImplementedError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def load(path: str | Path, kinds: Mapping[str, str], expected: str) -> dict[str, NDArray[Any]]:
    """Read an archive.

    Args:
        path: The file.
        kinds: Members, all of them needed, and the kind of each: ``"iu"`` integers, ``"U"`` text,
            ``"f"`` real numbers, ``"b"`` booleans.
        expected: What the file should have been, for the message.

    Raises:
        MissingFileError: There is no such file.
        InputError: It is too large, damaged, or holds something else.
    """
    path = Path(path)
    try:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):
            raise InputError(str(path), "is no plain file", expected)
        if about.st_size > MOST_BYTES:
            raise InputError(str(path), f"{about.st_size} bytes", f"at most {MOST_BYTES}")
        with zipfile.ZipFile(path) as archive:
            found = _checked(path, archive, kinds, expected)
            return {name: _member(path, archive, found[name], kinds[name]) for name in kinds}
    except FileNotFoundError:
        raise MissingFileError(str(path), "no such file", expected) from None
    except InputError:
        raise
    except OSError as error:
        detail = error.strerror or "damaged"
        raise InputError(str(path), f"cannot be read: {detail}", expected) from None
    except _DAMAGED:
        raise InputError(str(path), "is no NPZ archive, or damaged", expected) from None


def _checked(
    path: Path, archive: zipfile.ZipFile, kinds: Mapping[str, str], expected: str
) -> dict[str, zipfile.ZipInfo]:
    """The members by name: each there once, and together not too large."""
    infos = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
    missing, unknown = sorted(set(kinds) - set(infos)), sorted(set(infos) - set(kinds))
    if missing or unknown:
        what = f"{missing[0]!r} is missing" if missing else f"{unknown[0][:40]!r} is unknown"
        raise InputError(str(path), what, expected)
    if sum(info.file_size for info in infos.values()) > MOST_BYTES:
        raise InputError(str(path), "larger than it may be", f"at most {MOST_BYTES} bytes")
    if len(infos) < len(archive.infolist()) or any(
        info.compress_type not in _METHODS for info in infos.values()
    ):
        raise InputError(str(path), "is no NPZ archive, or damaged", expected)
    return infos


def _member(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo, kind: str) -> NDArray[Any]:
    where = f"{path}: {info.filename.removesuffix('.npy')}"
    with archive.open(info) as stream:
        data = io.BytesIO(stream.read(MOST_BYTES + 1))
    version = np.lib.format.read_magic(data)
    if version != (1, 0):
        raise InputError(where, f"array format {version[0]}.{version[1]}", "1.0")
    shape, _, dtype = np.lib.format.read_array_header_1_0(data, max_header_size=_MOST_HEADER)
    if dtype.hasobject or dtype.kind not in kind or dtype.itemsize > _MOST_ITEM:
        raise InputError(where, f"found {dtype!s:.60}", _WORDS[kind])
    left = len(data.getbuffer()) - data.tell()
    if any(length < 0 for length in shape) or math.prod(shape) * dtype.itemsize != left:
        raise InputError(where, f"{left} bytes do not make shape {shape!s:.60}", "a whole array")
    data.seek(0)
    array: NDArray[Any] = np.lib.format.read_array(data, allow_pickle=False)
    return array
