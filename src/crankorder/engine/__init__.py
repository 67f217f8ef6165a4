"""The engine as a model: what forces a crank mechanism makes, order by order."""
