"""Settings of every stage, recipes, engines and scenes (TOML only, no code)."""
