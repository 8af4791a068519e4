"""The rig: the robot's stand-in, with emulated drives, buses, a plant, and faults."""

from pathlib import Path

SCENARIOS = Path(__file__).parent / "scenarios"
"""Folder of the shipped scenarios."""
