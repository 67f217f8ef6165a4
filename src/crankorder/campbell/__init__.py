"""Frequency frames and the speed-frequency map."""
