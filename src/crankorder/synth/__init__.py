"""Scenes: recordings as a test cell would have made them, with the truth beside."""
