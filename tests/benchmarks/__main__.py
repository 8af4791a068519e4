"""``make benchmark``: each number of this program beside its floor, measured in the same run.

Prints one JSON object. Meant for an idle machine; says what it could not measure.
"""

from __future__ import annotations

import argparse
import json
import sys

from tests.benchmarks import timings


def main() -> None:
    """Run the benchmarks and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=10, help="of each timing run")
    parser.add_argument("--robots", nargs="+", default=["ur5", "panda"])
    options = parser.parse_args()
    results = {
        "plant": [timings.plant(name) for name in options.robots],
        "wake_up": timings.wake_ups(options.seconds),
    }
    json.dump(results, sys.stdout, indent=2)
    print()


if __name__ == "__main__":
    main()
