"""Bearing lines in the vibration and in its envelope, with slip, verdict and trend."""
