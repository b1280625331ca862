"""Priority inheritance with backtracking (PIBT), and the safety layer made of it."""
