"""The controller again, over what a log holds: the same classes, the logged feedback."""
