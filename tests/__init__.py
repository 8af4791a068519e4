"""The tests; a package, so that ``python -m tests.benchmarks`` finds it before anyone else's."""
