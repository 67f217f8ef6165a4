"""Orders, natural frequencies, bearings and crossings, named with evidence."""
