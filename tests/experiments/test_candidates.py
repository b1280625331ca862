"""The search for better settings of imitation."""

import math
from dataclasses import replace

import pytest

from experiments.pages import read_rows
from experiments.policies import candidates, imitation
from mapf_pz.rl.progress import write_progress

NAMES = [candidate.name for candidate in candidates.candidates()]


@pytest.fixture
def runs(tmp_path, monkeypatch):
    """Later candidates are better, with seed 1 worse; the runs that were trained."""
    runs, tables = [], []

    def trained(config, seed, agent_steps, run):
        runs.append((run.name, seed, agent_steps))
        run.mkdir()
        row = {"agent_steps": agent_steps / 2, "seconds": 180, "loss": 0.5, "agreement": 0.75}
        write_progress(run, [row | {"validation_CSR": math.nan}, row | {"validation_CSR": 0.25}])
        return {"hours": "0.10"}

    def measured(preset, policies, output, episodes):
        best = max(NAMES.index(name) for name in NAMES if policies[0].split("/")[-1].startswith(name.replace(" ", "-")))
        return dict.fromkeys(imitation.MEASURES, f"{(-best if output.name.endswith('-1') else best) / 100:.3f}")

    monkeypatch.setattr(imitation, "trained", trained)
    monkeypatch.setattr(imitation, "measured", measured)
    for name, file in {"STUDY": "candidates.csv", "CURVES": "candidate-curves.csv"}.items():
        monkeypatch.setattr(candidates, name, replace(getattr(candidates, name), file=tmp_path / file))
    monkeypatch.setattr(candidates, "write_table", lambda page, name, lines: tables.append(list(lines)))
    kept = list(candidates.candidates())[5:]
    monkeypatch.setattr(candidates, "candidates", lambda: iter(kept))
    names = tuple(candidate.name for candidate in kept)
    candidates.main(candidates.Options(tmp_path, names, lengths=(100, 200, 400)))
    return runs, tables, tmp_path


def test_the_better_half_is_trained_for_twice_as_long_and_progress_is_kept(runs):
    trained, tables, output = runs
    assert [steps for _, _, steps in trained] == [100] * 5 + [200] * 3 + [400] * 2
    assert [name for name, _, _ in trained[5:]] == [
        "three-rounds-200-0",
        "view-11-x-11-200-0",
        "wider-layers-200-0",
        "view-11-x-11-400-0",
        "wider-layers-400-0",
    ]
    lines = tables[-1]
    columns = "mazes 32 | mazes 64 | random 32 | random 64 | mean |"
    assert lines[0] == f"| candidate | seeds | million agent steps | hours | {columns}"
    assert lines[2] == "| wider layers | 1 | 0.0001 | 0.10 | 0.09 | 0.09 | 0.09 | 0.09 | 0.090 |"
    assert lines[-1].startswith("| view 11 x 11 | 1 | 0.0004 |")
    rows = read_rows(output / "candidate-curves.csv")
    assert len(rows) == 2 * 10
    last = {"candidate": "wider layers", "seed": "0", "agent_steps": "400", "agent_steps_so_far": "200"}
    last |= {"hours": "0.050", "loss": "0.500", "agreement": "0.750"}
    assert rows[-2:] == [last | {"validation_CSR": ""}, last | {"validation_CSR": "0.250"}]


def test_cells_have_the_range_over_seeds():
    rows = [
        {"candidate": "preset", "seed": seed, "agent_steps": "400", "hours": "0.10"}
        | dict.fromkeys(imitation.MEASURES, value)
        for seed, value in (("0", "0.500"), ("1", "0.700"))
    ]
    *_, line = candidates.table(rows)
    assert line.startswith("| preset | 2 | 0.0004 | 0.10 | 0.60 (0.50 to 0.70) |")
    assert line.endswith("| 0.600 (0.500 to 0.700) |")
