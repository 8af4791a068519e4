"""The command ``dftc``: one thin function a command, errors as one line and an exit code."""

from __future__ import annotations

import os
import sys

from cyclopts import App, Parameter

from dftc_rt.cli import analyze, control, doctor, hil, recover, report, rig, robots, simulate
from dftc_rt.errors import DftcError


def build() -> App:
    """Return the command-line application."""
    app = App(
        name="dftc",
        help="Decentralised fault-tolerant control for URDF robots.",
        version_flags=["--version"],
        help_format="restructuredtext",
        print_error=False,
        exit_on_error=False,
        result_action="return_value",
        # A flag has a negative form only where it is on by default.
        default_parameter=Parameter(negative=()),
    )
    for function in (
        simulate.simulate,
        hil.hil,
        rig.rig,
        control.control,
        analyze.analyze,
        report.report,
        recover.recover,
        robots.robots,
        doctor.doctor,
    ):
        app.command(function)
    return app


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit."""
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: list[str]) -> int:
    """Run one command; return its exit code, having printed any error as one line."""
    from cyclopts import CycloptsError

    try:
        code = build()(arguments)
        sys.stdout.flush()
        return int(code or 0)
    except DftcError as error:
        print(f"dftc: {error}", file=sys.stderr)
        return error.exit_code
    except CycloptsError as error:
        print(f"dftc: {' '.join(str(error).split())} (see 'dftc --help')", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of our output has gone; there is nobody to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
