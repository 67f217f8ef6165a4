"""Order lines over a stated false-alarm level, their numbers, locks and growth."""
