"""What makes a line: a cause for each, by rules tried in order, with what says so."""
