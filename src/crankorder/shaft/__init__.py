"""Encoder pulses become crank angle and speed, with a standard error."""
