"""What the emulated drives are: protocol, object dictionary, sensors."""
