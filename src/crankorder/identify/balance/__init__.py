"""What unbalance is left, in grams, by the engine model or stated paths."""
