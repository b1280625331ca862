"""The pages on experiments: their generated tables."""

import pytest

from experiments import pages
from experiments.ideas import capacity, curiosity, edge_weights, observed_weights
from experiments.planners import weighted_cost
from experiments.policies import candidates, imitation
from experiments.report import published


@pytest.mark.parametrize(
    "experiment", [candidates, capacity, curiosity, edge_weights, imitation, observed_weights, published, weighted_cost]
)
def test_the_table_of_the_page_is_that_of_the_results(tmp_path, monkeypatch, experiment):
    text, page = experiment.PAGE.read_text(), tmp_path / "page.md"
    page.write_text(text)
    tables = []

    def write_table(where, name, lines):
        assert where == experiment.PAGE
        tables.append(name)
        pages.write_table(page, name, lines)

    monkeypatch.setattr(experiment, "write_table", write_table)
    experiment.write()
    assert page.read_text() == text
    assert tables
    assert all(f"<!-- {name} -->" in text for name in tables)
