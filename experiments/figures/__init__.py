"""Programs that draw the figures and take the screenshots of the documentation."""
