"""Natural frequencies and damping: one joint fit of the floor of the Campbell map and of the order responses."""
