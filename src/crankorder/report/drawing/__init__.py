"""What pictures of the report are made of: what is drawn, type, axes, keys and labels."""
