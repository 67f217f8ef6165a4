"""Order frames, order maps and order tracks."""
