"""``python -m tests.benchmarks [name ...] [--quick] [--json FILE]``: each number with its floor.

Meant for an idle machine. On a shared one only the ratios mean something: both sides of
each were measured in turn.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

from dftc_rt.cli.session import versions
from dftc_rt.errors import EnvironmentLacksError
from tests.benchmarks.result import SECONDS_VARIABLE, Result, plain, show

NAMES = (
    "simulation",
    "compute",
    "exchange",
    "bus",
    "log",
    "realtime",
    "view",
    "faults",
    "chaos",
    "fuzz",
    "soak",
)


def machine() -> dict[str, Any]:
    """Return what the figures depend on."""
    processor = "unknown processor"
    if (info := Path("/proc/cpuinfo")).exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                processor = line.partition(":")[2].strip()
                break
    return {
        "processor": processor,
        "cores": len(os.sched_getaffinity(0)),
        "system": f"{platform.system()} {platform.release()}",
        "load": [round(load, 2) for load in os.getloadavg()],
        "versions": versions(),
    }


def run(name: str, quick: bool) -> Result:
    """Run one benchmark; what the machine lacks for it becomes a note."""
    module = import_module(f"tests.benchmarks.{name}")
    try:
        result: Result = module.run(quick)
    except EnvironmentLacksError as error:
        return Result(name, notes=[f"{name} not measured: {error}"])
    return result


def main() -> None:
    """Run the benchmarks and print the results."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="name", help=f"of {', '.join(NAMES)}; all")
    parser.add_argument("--quick", action="store_true", help="short runs: see that it works")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the results here too")
    parser.add_argument("--seconds", type=float, help="how long soak and chaos last")
    options = parser.parse_args()
    if options.seconds is not None:
        os.environ[SECONDS_VARIABLE] = str(options.seconds)
    if unknown := set(options.names) - set(NAMES):
        parser.error(f"no benchmark {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    where = machine()
    print(
        f"{where['processor']}, {where['cores']} cores, {where['system']}, "
        f"load {' '.join(map(str, where['load']))}"
    )
    results = []
    for name in options.names or NAMES:
        begun = time.monotonic()
        result = run(name, options.quick)
        show(result, sys.stdout)
        print(f"  ({name}: {time.monotonic() - begun:.0f} s)", flush=True)
        results.append(plain(result))
    if options.json is not None:
        found = {"machine": where, "quick": options.quick, "results": results}
        options.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
