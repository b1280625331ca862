"""Plans: validation, files, and recordings."""
