"""The command ``dftc``: one thin function a command, errors as one line and an exit code."""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Final

from dftc_rt.cli import interruption, streams
from dftc_rt.errors import DftcError

if TYPE_CHECKING:
    from cyclopts import App

# In the order in which the help shows them: each is a module here with a function of its name.
_COMMANDS: Final = (
    "simulate", "hil", "rig", "control", "play", "calibrate", "identify", "analyze", "report",
    "view", "export", "replay", "recover", "paper", "benchmark", "robots", "doctor", "bus", "fault",
)  # fmt: skip
_GROUPS: Final = ("bus", "fault")  # their function makes an application with commands of its own


def build(only: str | None = None) -> App:
    """Return the command-line application.

    Args:
        only: The first word of the command line. With a command, the others and all that they
            import, which takes time, are left out; with ``--version``, all are. With anything
            else, or nothing, all are in.
    """
    from cyclopts import App, Parameter  # that takes its time, too, and Ctrl-C must work in it

    app = App(
        name="dftc",
        help="Decentralised fault-tolerant control for URDF robots.",
        version_flags=["--version"],
        help_format="restructuredtext",
        print_error=False,
        exit_on_error=False,
        result_action="return_value",
        suppress_keyboard_interrupt=False,  # run() says so
        # A flag has a negative form only where it is on by default.
        default_parameter=Parameter(negative=()),
    )
    wanted = tuple(name for name in _COMMANDS if name == only)
    if not wanted and only != "--version":
        wanted = _COMMANDS
    for name in wanted:
        function = getattr(importlib.import_module(f"dftc_rt.cli.{name}"), name)
        app.command(function() if name in _GROUPS else function)
    return app


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit."""
    streams.guard()
    interruption.leave_at_once()
    arguments = sys.argv[1:] if arguments is None else arguments
    app = build(*arguments[:1])
    interruption.interrupt_once()
    sys.exit(run(arguments, app))


def run(arguments: list[str], app: App | None = None) -> int:
    """Run one command; return its exit code, having printed any error as one line."""
    from cyclopts import CycloptsError

    try:
        code = (app or build(*arguments[:1]))(arguments)
        sys.stdout.flush()
        return int(code or 0)
    except streams.OutputError as error:
        return streams.answer(error)
    except DftcError as error:
        print(f"dftc: {error}", file=sys.stderr)
        return error.exit_code
    except CycloptsError as error:
        print(f"dftc: {' '.join(str(error).split())} (see 'dftc --help')", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("dftc: interrupted", file=sys.stderr)
        return interruption.EXIT_CODE
