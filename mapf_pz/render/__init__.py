"""Pictures and texts of an instance; they know no environment."""
