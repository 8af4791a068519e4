"""What this machine offers: the few questions that ``dftc doctor`` asks of it.

Everything here touches the operating system and decides nothing, so that
:mod:`dftc_rt.rt.doctor` can be tested against a machine made of plain values.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shutil
import socket
import sys
from pathlib import Path

from dftc_rt.bus import directory
from dftc_rt.bus.link_kind import link_kind
from dftc_rt.errors import EnvironmentLacksError, InputError

MCL_CURRENT = 1


class Machine:
    """The machine this process runs on."""

    @property
    def python(self) -> tuple[int, int]:
        """Version of the running interpreter."""
        return sys.version_info[:2]

    @property
    def system(self) -> str:
        """Name of the operating system, ``Linux`` where this project runs."""
        return os.uname().sysname

    @property
    def cores(self) -> int:
        """Number of cores that this process may use."""
        return len(os.sched_getaffinity(0))

    @property
    def kernel_caches(self) -> tuple[str, ...]:
        """Directories in which numba may keep compiled kernels, in its own order."""
        chosen = os.environ.get("NUMBA_CACHE_DIR")
        if chosen:
            return (chosen,)
        package = Path(__file__).parents[1]
        user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "numba")
        return str(package / "control"), str(user)

    def variable(self, name: str) -> str:
        """Return an environment variable, "" when unset."""
        return os.environ.get(name, "")

    def read(self, path: str) -> str | None:
        """Return a file's text, None when it cannot be read."""
        try:
            return Path(path).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return None

    def paths(self, pattern: str) -> list[str]:
        """Return the existing paths below ``/`` that match ``pattern``, sorted."""
        return sorted(str(p) for p in Path("/").glob(pattern.lstrip("/")))

    def bus_directory(self) -> tuple[Path, str]:
        """Return the directory of the user-space buses, and why it cannot be used ("" if it can).

        Nothing is created: where the directory is missing, its parent is asked.
        """
        path = directory.resolve_directory()
        if not os.path.lexists(path):
            usable = os.access(path.parent, os.W_OK | os.X_OK)
            return path, "" if usable else f"{path.parent} is missing or not writable"
        try:
            directory.check_directory(path)
        except InputError as error:
            return path, error.what
        return path, ""

    def writable(self, path: str) -> bool:
        """Return whether a path may be written, or created where it does not exist yet."""
        place = Path(path)
        while not place.exists() and place != place.parent:
            place = place.parent
        return os.access(place, os.W_OK)

    def program(self, name: str) -> str:
        """Return where a program is, "" when it is not installed."""
        return shutil.which(name) or ""

    def has_module(self, name: str) -> bool:
        """Return whether a Python module is installed (it is not imported)."""
        try:
            return importlib.util.find_spec(name) is not None
        except ImportError:
            return False

    def refuses_fifo(self) -> str:
        """Take SCHED_FIFO and give it back; return why not, "" when permitted."""
        policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        except OSError as error:
            return error.strerror or str(error)
        os.sched_setscheduler(0, policy, parameter)
        return ""

    def refuses_mlockall(self) -> str:
        """Lock this process into memory and unlock it; return why not, "" when permitted."""
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mlockall(MCL_CURRENT) != 0:
            return os.strerror(ctypes.get_errno())
        libc.munlockall()
        return ""

    def refuses_can(self) -> str:
        """Open and close a raw CAN socket; return why not, "" when the kernel has AF_CAN."""
        try:
            socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
        except OSError as error:
            return error.strerror or str(error)
        return ""

    def vcan_links(self) -> list[str]:
        """Return the network links of kind vcan."""
        links = []
        for _, name in socket.if_nameindex():
            try:
                if link_kind(name) == "vcan":
                    links.append(name)
            except EnvironmentLacksError:
                return []
        return sorted(links)

    def refuses_seqpacket(self) -> str:
        """Open and close an AF_UNIX SOCK_SEQPACKET pair; return why not, "" when possible."""
        try:
            pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        except OSError as error:
            return error.strerror or str(error)
        for end in pair:
            end.close()
        return ""
