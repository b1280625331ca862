"""Learning curves, and the command that draws them."""

import dataclasses
import math

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.errors import FormatError
from mapf_pz.rl.config_file import config_values, save_config
from mapf_pz.rl.progress import PROGRESS, append_progress, read_progress, write_progress
from mapf_pz.rl.training.curves import EPISODES, Run, draw_curves
from tests.helpers.small_run import TINY, changed

CONFIG = dataclasses.replace(TINY, task=changed(TINY.task, max_steps=32))


def row(number, episodes, rate, **others):
    return {"agent_steps": number * 192.0, "episodes": float(episodes), "CSR": rate, "return": -rate, **others}


def run(*rows, name="run", config=CONFIG):
    return Run(name, config_values(dataclasses.replace(config, seed=0, agent_steps=1)), list(rows))


def test_points_are_weighted_by_episodes():
    steps, values = run(row(1, 10, 1.0), row(2, 90, 0.0), row(3, 50, 0.5), row(4, 100, 0.7)).curve("CSR")
    np.testing.assert_allclose(steps * 1e6, [192, 384, 576, 768])
    np.testing.assert_allclose(values, [1, 0.1, 25 / 140, 0.7])


def test_a_point_is_the_mean_of_enough_episodes():
    rows = [row(number, 10, float(number % 2)) for number in range(1, 31)]
    steps, values = run(*rows).curve("CSR")
    assert len(steps) == 30
    assert EPISODES == 100
    np.testing.assert_allclose(values[9:], 0.5)  # from ten updates on
    np.testing.assert_allclose(values[:4], [1, 1 / 2, 2 / 3, 2 / 4])


def test_updates_without_episodes_have_no_point():
    rows = row(1, 0, math.nan), row(2, 0, math.nan), row(3, 40, 0.25), row(4, 0, math.nan), row(5, 40, 0.75)
    steps, values = run(*rows).curve("CSR")
    np.testing.assert_allclose(steps * 1e6, [576, 960])
    np.testing.assert_allclose(values, [0.25, 0.5])


def test_data_without_episodes_is_drawn_as_it_is():
    rows = [{"agent_steps": 192.0 * number, "agreement": number / 10} for number in range(1, 5)]
    steps, values = run(*rows, config=dataclasses.replace(CONFIG, algorithm="bc")).curve("agreement")
    assert len(steps) == len(values) == 4
    np.testing.assert_allclose(values, [0.1, 0.2, 0.3, 0.4])


def test_validations_are_points():
    rows = [row(1, 1, 0.5, validation_CSR=math.nan), row(2, 1, 0.5, validation_CSR=0.75)]
    steps, values = run(*rows).validations("CSR")
    np.testing.assert_allclose(steps * 1e6, [384])
    assert values.tolist() == [0.75]
    assert run(row(1, 1, 0.5)).validations("CSR")[0].size == 0


def write_run(folder, rate, **fields):
    folder.mkdir()
    config = dataclasses.replace(CONFIG, **fields)
    save_config(folder, config)
    write_progress(folder, [row(number, 50, rate, validation_CSR=rate) for number in range(1, 13)])
    return folder


def test_runs_that_differ_in_their_seeds_are_one_curve(tmp_path):
    runs = [
        write_run(tmp_path / "a", 0.2, seed=1),
        write_run(tmp_path / "b", 0.4, seed=2),
        write_run(tmp_path / "c", 0.6, num_threads=2),
    ]
    file = tmp_path / "curves.svg"
    words = ["plot", *map(str, runs), "--columns", "CSR", "return", "--output", str(file)]
    assert main(words) == 0
    text = file.read_text()
    for label in ("a, 2 seeds", "c", "a, 2 seeds, validation", "mean episode return per agent"):
        assert f"<!-- {label} -->" in text
    assert "<!-- b -->" not in text


@pytest.mark.parametrize("name", ["curves.png", "curves.pdf"])
def test_formats_of_figures(tmp_path, name):
    draw_curves([run(row(1, 1, 0.5), row(2, 1, 0.5))], ["CSR"], tmp_path / name)
    assert (tmp_path / name).read_bytes()[:4] in (b"\x89PNG", b"%PDF")


def test_progress_is_read_back(tmp_path):
    rows = [row(1, 0, math.nan), row(2, 3, 0.25)]
    append_progress(tmp_path, rows[0], is_first=True)
    append_progress(tmp_path, rows[1], is_first=False)
    appended = (tmp_path / PROGRESS).read_bytes()
    write_progress(tmp_path, rows)
    assert (tmp_path / PROGRESS).read_bytes() == appended
    np.testing.assert_equal(read_progress(tmp_path), rows)
    np.testing.assert_equal(read_progress(tmp_path, 1), rows[:1])


@pytest.mark.parametrize("text", ["agent_steps,CSR\r\n12,x\r\n", "agent_steps,CSR\r\n12\r\n"])
def test_a_damaged_file_of_progress_is_refused(tmp_path, text):
    (tmp_path / PROGRESS).write_text(text)
    with pytest.raises(FormatError, match=r"progress.csv.*damaged"):
        read_progress(tmp_path)


def test_wrong_folders_are_refused_in_one_line(tmp_path, capsys):
    (tmp_path / "none").mkdir()
    lifelong = write_run(tmp_path / "a", 0.5)
    empty = write_run(tmp_path / "empty", 0.5)
    (empty / PROGRESS).write_text("agent_steps,CSR\r\n")
    for words in ([], [str(tmp_path / "none")], [str(empty)], [str(lifelong), "--columns", "throughput"]):
        assert main(["plot", *words, "--output", str(tmp_path / "x.png")]) == 1
        [line] = capsys.readouterr().err.splitlines()
        assert line.startswith("mapf-pz plot: ")
    assert not (tmp_path / "x.png").exists()
