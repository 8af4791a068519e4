"""The real-time side: clock, executor, supervisor, process, and the link to the drives."""
