"""The command line: one thin file a command, a plain Python function under each."""
