"""Figures, the report page and the result files."""
