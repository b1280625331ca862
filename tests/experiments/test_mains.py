"""The studies that have no tests of their own: each measures what is missing, and writes its table."""

from dataclasses import replace

import pytest

pytest.importorskip("torchrl")

from experiments.ideas import capacity, edge_weights, observed_weights
from experiments.planners import weighted_cost
from experiments.report import repair


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A function that runs a study twice, and returns its runs; no training takes place."""

    def run(experiment, **options):
        tables = []
        monkeypatch.setattr(experiment, "STUDY", replace(experiment.STUDY, file=tmp_path / "study.csv"))
        monkeypatch.setattr(experiment, "write_table", lambda page, name, lines: tables.append(list(lines)))
        for _ in range(2):
            experiment.main(experiment.Options(**options))
        assert len(tables) == 2
        assert tables[0] == tables[1]
        assert len(tables[0]) > 2
        return [tuple(row[name] for name in experiment.STUDY.key) for row in experiment.STUDY.rows()]

    return run


def trained(config, run, overwrite):
    run.mkdir()
    (run / "policy.safetensors").touch()


def test_edge_weights(run, tmp_path, monkeypatch):
    monkeypatch.setattr(edge_weights, "train", trained)
    monkeypatch.setattr(edge_weights, "_agreement", lambda run: "0.5")
    monkeypatch.setattr(edge_weights, "_measures", lambda task, policy, episodes: {"throughput": "1", "cost": "2"})
    runs = run(edge_weights, output=tmp_path, seeds=(0, 1))
    assert runs == [("the planner", "0"), *((name, seed) for seed in "01" for name in edge_weights.SETTINGS)]


def test_observed_weights(run, tmp_path, monkeypatch):
    monkeypatch.setattr(observed_weights, "train", trained)
    values = dict.fromkeys(observed_weights.METRICS, "0.5")
    monkeypatch.setattr(observed_weights, "policy_means", lambda policy, training, episodes: values)
    runs = run(observed_weights, output=tmp_path, seeds=(0,), episodes=2)
    observed = [f"{name}, temperature {t:g}" for name in observed_weights.CHANNELS for t in (0.5, 0)]
    names = (*observed_weights.REFERENCES, *observed)
    assert [name for name, _ in runs] == [
        f"{weights}: {name}" for weights in observed_weights.WEIGHTS for name in names
    ]
    assert len(list(tmp_path.glob("*-0"))) == len(observed_weights.WEIGHTS) * len(observed_weights.CHANNELS)
    found = {row["setting"]: row[observed_weights.SOLVED] for row in observed_weights.STUDY.rows()}
    for weights in observed_weights.WEIGHTS:
        costs = [float(found[f"{weights}: {name}"]) for name in observed_weights.REFERENCES]
        assert costs[0] > costs[1] >= 1, "a planner that knows the weights pays less"


def test_capacity(run, monkeypatch):
    monkeypatch.setattr(capacity, "HELD_OUT", 1)
    runs = run(capacity, seeds=(0,), steps=2)
    assert runs == [(str(n), network, "0") for n in capacity.NUM_AGENTS for network in capacity.WIDTHS]
    assert all(0.25 < float(row["accuracy"]) < 1 for row in capacity.STUDY.rows())


def test_weighted_cost(run, monkeypatch):
    monkeypatch.setattr(weighted_cost, "PLANNERS", {"pibt": "pibt"})
    assert run(weighted_cost, seeds=2) == [("pibt", *case, seed) for case in weighted_cost.CASES for seed in "01"]


def test_repair(run, tmp_path, monkeypatch):
    settings = list(repair.settings())[:2]
    monkeypatch.setattr(repair, "settings", lambda: iter(settings))
    results = [{"agent_steps": steps, "CSR": "0.25", "ISR": "0.5"} for steps in ("4", "8")]
    monkeypatch.setattr(repair, "learn", lambda setting, seed, options: results)
    names = [setting.name for setting in settings]
    runs = [(name, seed) for name in names for seed in "01" for _ in results]
    assert run(repair, output=tmp_path, seeds=(0, 1)) == runs
