"""Benchmark over robots, faults and laws: cases, what is measured of a run, the page."""
