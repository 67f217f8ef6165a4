"""Planned transforms, windows and their scalings, decimation and resampling kernels."""
