from dataclasses import replace
from xml.etree import ElementTree

import pytest

from mapf_pz.evaluation import Episode

pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")

from mapf_pz.evaluation.reports.figures import draw_figures  # noqa: E402


def episodes(task_name, counts, *names, **metrics):
    return [
        Episode(name, task_name, count, number, {metric: value / (1 + number) for metric, value in metrics.items()})
        for name in names
        for count in counts
        for number in range(3)
    ]


def test_a_figure_for_each_task_with_several_numbers_of_agents(tmp_path):
    drawn = draw_figures(
        episodes("maze, 8 x 8", [4, 8, 16], "pibt", "random", CSR=0.5, ISR=0.5, step_ms=1.0)
        + episodes("warehouse", [10], "pibt", CSR=1.0, ISR=1.0)
        + episodes("lifelong", [8, 4], "pibt", avg_throughput=1.0, step_ms=0.1),
        tmp_path,
    )
    assert drawn == [tmp_path / "maze--8-x-8.png", tmp_path / "lifelong.png"]
    assert sorted(tmp_path.iterdir()) == sorted(drawn)
    widths = []
    for file in drawn:
        with Image.open(file) as image:
            widths.append(image.width)
    assert 2 * widths[0] == pytest.approx(3 * widths[1], abs=3)  # a panel for each metric


def test_policies_of_one_number_of_agents_have_no_figure(tmp_path):
    assert draw_figures(episodes("maze", [4], "pibt", "random", CSR=1.0), tmp_path) == []
    assert draw_figures([], tmp_path) == []
    assert list(tmp_path.iterdir()) == []


def test_a_policy_with_fewer_numbers_of_agents(tmp_path):
    tried = episodes("maze", [4], "random", CSR=1.0) + episodes("maze", [4, 8], "pibt", CSR=1.0)
    assert len(draw_figures(tried, tmp_path)) == 1


def test_figures_of_similar_names_are_separate_files(tmp_path):
    tried = [episode for name in ("a b", "a-b", "a-b-2", "a/b") for episode in episodes(name, [1, 2], "x", CSR=1.0)]
    drawn = draw_figures(tried, tmp_path)
    assert [file.name for file in drawn] == ["a-b.png", "a-b-2.png", "a-b-2-2.png", "a-b-3.png"]
    assert all(file.exists() for file in drawn)


def test_control_characters_in_names_leave_figures_valid(tmp_path):
    (file,) = draw_figures(episodes("maze\x07\x1b", [1, 2], "pibt\x00\ud800", CSR=1.0), tmp_path, "svg")
    ElementTree.parse(file)


def test_names_are_no_formulas(tmp_path):
    (file,) = draw_figures(episodes(r"cost $\frac{", [1, 2], "$x_$", CSR=1.0), tmp_path)
    assert file.exists()


@pytest.mark.parametrize("format", ["pdf", "svg"])
def test_vector_figures_with_published_results(tmp_path, format):
    tried = episodes("maze", [4, 8], "pibt", CSR=0.0) + episodes("goals", [4, 8], "pibt", avg_throughput=1.0)
    published = [
        *episodes("maze", [4, 8], "DCC (published)", CSR=1.0),
        *episodes("goals", [4, 8], "RHCR (published)", avg_throughput=2.0),
    ]
    maze, goals = draw_figures(tried, tmp_path, format, published)
    assert (maze.name, goals.name) == (f"maze.{format}", f"goals.{format}")
    assert maze.read_bytes()[:5] == (b"%PDF-" if format == "pdf" else b"<?xml")
    if format == "svg":
        assert "DCC (published)" in maze.read_text()
        assert "RHCR" not in maze.read_text()
        assert "RHCR (published)" in goals.read_text()


def test_figures_state_the_suite(tmp_path):
    tried = [replace(one, suite="mine/2 0123456789abcdef") for one in episodes("maze", [4, 8], "pibt", CSR=0.0)]
    (file,) = draw_figures(tried, tmp_path, "svg")
    assert "maze (mine/2 0123456789abcdef)" in file.read_text()
    tried[0] = replace(tried[0], suite="mine/1 0123456789abcdef")
    with pytest.raises(ValueError, match="task '4 agents on maze': its results belong to 'mine/1"):
        draw_figures(tried, tmp_path, "svg")
