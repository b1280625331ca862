"""The cards of the package's policies."""

import pytest

from experiments.policies import cards
from mapf_pz.rl.policies.folder import bundled, policy_names


@pytest.mark.parametrize("name", policy_names())
def test_a_card_is_as_written_and_has_limits_and_results(name):
    text = (bundled() / name / "README.md").read_text("utf-8")
    assert text == cards.text(name), "run python -m experiments.policies.cards"
    _, _, results = text.partition("## Results")
    assert "Limits: " in results
    assert f"| **{name}" in results or f"| `{name}" in results


def test_a_policy_without_results_has_a_card(tmp_path, monkeypatch):
    name = policy_names()[0]
    (tmp_path / "mine").mkdir()
    for file in (bundled() / name).iterdir():
        (tmp_path / "mine" / file.name).write_bytes(file.read_bytes())
    monkeypatch.setattr(cards, "bundled", lambda: tmp_path)
    cards.write("mine")
    text = (tmp_path / "mine" / "README.md").read_text()
    assert text.startswith("---\nlicense: mit\n")
    assert "## Results" not in text
