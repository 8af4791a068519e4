"""The identifier's networks, trained offline on fault-free motion and then frozen."""
