"""The simulated hand: its firmware, and its end of the CAN bus."""
