"""Where orders meet natural frequencies, and which speeds to avoid, are free, or are left open."""
