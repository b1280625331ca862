"""The result tables of the documentation."""
