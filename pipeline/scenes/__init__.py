"""Synthetic tests."""
