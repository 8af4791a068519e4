"""CiA 402 cyclic synchronous torque over CANopen."""
