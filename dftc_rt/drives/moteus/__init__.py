"""mjbots moteus over CAN FD: registers, torque by position mode without its gains."""
