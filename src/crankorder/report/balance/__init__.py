"""Text, figures and dataset of `crankorder balance`: the engine alone."""
