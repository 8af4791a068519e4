"""MIT mini-cheetah protocol over classical CAN: torque by the feed-forward field alone."""
