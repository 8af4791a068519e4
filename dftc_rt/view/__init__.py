"""The page in a browser: a robot that moves, live or out of a log, and a panel of faults."""
