"""Checks of this machine, its radio and the path to the peer: what is found, why it matters, what mends it."""
