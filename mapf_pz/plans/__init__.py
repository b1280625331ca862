"""Plans: their files, what is wrong with them, and recordings of them."""
