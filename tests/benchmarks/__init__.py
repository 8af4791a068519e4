"""Benchmarks, each number beside its floor from the same run: ``make benchmark``."""
