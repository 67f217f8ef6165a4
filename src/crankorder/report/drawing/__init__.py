"""What pictures are made of: canvas, type, axes, keys and labels."""
