"""From fault-free motion to what the controller believes, and to how far it may be believed."""
