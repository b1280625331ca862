"""Priority inheritance with backtracking (PIBT)."""
