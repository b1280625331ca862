import pytest


@pytest.fixture(autouse=True)
def _without_figures(without_figures: None) -> None:
    """Apply to all tests of this folder."""
