"""Experiments on the package's policies, and the programs that bundle them."""
