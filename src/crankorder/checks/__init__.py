"""Recordings beside each other: doubts about gains, clocks and lengths, and what is left out for them."""
