"""Engine data."""
