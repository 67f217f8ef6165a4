"""Recipes: the results wanted and the settings that differ."""
