"""Closure with the engine model: what unbalance is left, in grams."""
