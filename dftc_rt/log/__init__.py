"""The log of a run: what a record is, writing, reading, repairing. Alone touches MCAP."""
