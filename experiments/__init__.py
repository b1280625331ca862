"""Programs behind the documentation's results; they are not part of the package."""
