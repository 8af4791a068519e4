"""The rig's end of the buses: ports, arbitration, accounting."""
