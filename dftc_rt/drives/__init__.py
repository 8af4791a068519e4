"""Drive profiles: how torque commands and feedback become frames, and back."""
