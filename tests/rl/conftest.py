import pytest


@pytest.fixture(autouse=True)
def _without_figures(without_figures: None) -> None:
    """Apply to all tests of this folder."""


@pytest.fixture(autouse=True)
def _seeded() -> None:
    """Let no test depend on those that ran before it."""
    pytest.importorskip("torch").manual_seed(0)
