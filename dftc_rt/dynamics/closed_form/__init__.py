"""Plants whose equations of motion are written down, not derived from a URDF."""
