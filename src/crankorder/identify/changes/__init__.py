"""What differs between two tests, how surely, and what would explain it."""
