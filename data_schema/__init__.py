"""JSON Schemas of every dataset and file (no code)."""
