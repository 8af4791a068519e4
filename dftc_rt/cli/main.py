"""The command ``dftc``: one thin function a command, errors as one line and an exit code."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from dftc_rt.cli import interruption, streams
from dftc_rt.errors import DftcError

if TYPE_CHECKING:
    from cyclopts import App

# Everything else is imported in build(): that takes a second, and Ctrl-C must work in it.


def build() -> App:
    """Return the command-line application."""
    from cyclopts import App, Parameter

    from dftc_rt.cli import (
        analyze,
        benchmark,
        bus,
        calibrate,
        control,
        doctor,
        export,
        fault,
        hil,
        identify,
        paper,
        play,
        recover,
        replay,
        report,
        rig,
        robots,
        simulate,
        view,
    )

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
    for function in (
        simulate.simulate,
        hil.hil,
        rig.rig,
        control.control,
        play.play,
        calibrate.calibrate,
        identify.identify,
        analyze.analyze,
        report.report,
        view.view,
        export.export,
        replay.replay,
        recover.recover,
        paper.paper,
        benchmark.benchmark,
        robots.robots,
        doctor.doctor,
    ):
        app.command(function)
    app.command(bus.bus())
    app.command(fault.fault())
    return app


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit."""
    streams.guard()
    interruption.leave_at_once()
    app = build()
    interruption.interrupt_once()
    sys.exit(run(sys.argv[1:] if arguments is None else arguments, app))


def run(arguments: list[str], app: App | None = None) -> int:
    """Run one command; return its exit code, having printed any error as one line."""
    from cyclopts import CycloptsError

    try:
        code = (app or build())(arguments)
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
