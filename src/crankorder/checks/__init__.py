"""Recordings beside each other: doubts about gains, speeds and lengths, and what is left out for them."""
