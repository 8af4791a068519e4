"""CAN buses: sockets, the user-space bus, bit times and budgets."""
