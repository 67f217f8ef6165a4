"""Page, pictures and sentences of `crankorder compare`."""
