"""Test-run folders, manifests and files become recordings."""
