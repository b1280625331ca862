"""Programs that produce the results and figures of the documentation; not part of the package."""
