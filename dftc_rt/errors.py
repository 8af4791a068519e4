"""Errors: one root, each also a built-in type, each carrying its data.

The exit code of a command is the ``exit_code`` of the error that ended it; the
message is the one line that the user sees.
"""

from __future__ import annotations

import inspect
from typing import Any, ClassVar, Final

_LONGEST: Final = 400  # characters of one part of a message


def plain(text: object, longest: int = _LONGEST) -> str:
    """Return a text from outside as a part of one line that a terminal can show.

    What is not printable is escaped; what is too long loses its middle.
    """
    shown = "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in str(text)
    )
    half = longest // 2
    return shown if len(shown) <= longest else f"{shown[:half]} … {shown[-half:]}"


class DftcError(Exception):
    """Root of every error this project raises on purpose."""

    exit_code: ClassVar[int] = 1

    def __reduce__(self) -> tuple[Any, ...]:
        """Let a worker process hand it on: it is made again from its data, not its message."""
        given = list(inspect.signature(type(self).__init__).parameters)[1:]
        return type(self), tuple(vars(self)[name] for name in given if name in vars(self))


class InputError(DftcError, ValueError):
    """Bad usage or bad input: says what, where, and what was expected.

    Attributes:
        where: File, key path, joint or frame that is wrong.
        what: What was found there.
        expected: What would have been accepted ("" when obvious from ``what``).
    """

    exit_code: ClassVar[int] = 2

    def __init__(self, where: str, what: str, expected: str = "") -> None:
        self.where = where
        self.what = what
        self.expected = expected
        super().__init__(self._line())

    def _line(self) -> str:
        tail = f" (expected {plain(self.expected)})" if self.expected else ""
        return f"{plain(self.where)}: {plain(self.what)}{tail}"


class MissingFileError(InputError, FileNotFoundError):
    """A file that the user named does not exist."""

    def __str__(self) -> str:
        return self._line()


class EnvironmentLacksError(DftcError, OSError):
    """The machine lacks something: says what, and how to get it.

    Attributes:
        lacks: What is missing.
        remedy: How to get it.
    """

    exit_code: ClassVar[int] = 3

    def __init__(self, lacks: str, remedy: str) -> None:
        self.lacks = lacks
        self.remedy = remedy
        super().__init__(f"{lacks}; {remedy}")

    def __str__(self) -> str:
        return f"{self.lacks}; {self.remedy}"


class DriveError(DftcError, RuntimeError):
    """A drive did not answer, or answered what it should not, during set-up.

    Attributes:
        joint: Joint whose drive it is ("" when the whole bus is meant).
        node_id: CANopen node id (0 when the whole bus is meant).
        bus: Logical bus name.
        what: What went wrong.
    """

    exit_code: ClassVar[int] = 1

    def __init__(self, joint: str, node_id: int, bus: str, what: str) -> None:
        self.joint = joint
        self.node_id = node_id
        self.bus = bus
        self.what = what
        who = f"{joint} (node {node_id} on {bus})" if joint else bus
        super().__init__(f"{who}: {what}")


class BusError(DftcError, OSError):
    """A bus went away or cannot be opened.

    Attributes:
        bus: Logical bus name or interface.
        what: What went wrong.
    """

    def __init__(self, bus: str, what: str) -> None:
        self.bus = bus
        self.what = what
        super().__init__(f"{bus}: {what}")

    def __str__(self) -> str:
        return f"{self.bus}: {self.what}"


class LawError(DftcError, RuntimeError):
    """A control law that is not ours raised something.

    Attributes:
        law: Its name, ``module:Class``.
        error: What it raised.
    """

    def __init__(self, law: str, error: Exception) -> None:
        self.law = law
        self.error = error
        place = ""
        trace = error.__traceback__
        while trace is not None:
            code = trace.tb_frame.f_code
            place = f" ({code.co_filename}:{trace.tb_lineno})"
            trace = trace.tb_next
        super().__init__(f"law {law}: {type(error).__name__}: {error}{place}")


class LogError(InputError):
    """A log cannot be read: torn, foreign, or lacking a topic."""
