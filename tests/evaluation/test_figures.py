from dataclasses import replace
from xml.etree import ElementTree

import pytest

from mapf_pz.evaluation import Episode

pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")

from matplotlib.figure import Figure  # noqa: E402

from mapf_pz.evaluation.reports.figures import draw_figures  # noqa: E402
from mapf_pz.evaluation.reports.overview import THRESHOLDS, draw_overview  # noqa: E402


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
    with Image.open(drawn[0]) as three, Image.open(drawn[1]) as two:
        assert (three.width, three.height > two.height) == (two.width, True)  # two panels in a row


@pytest.fixture
def drawings(monkeypatch):
    """Return a list of the figures that are saved."""
    saved = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, file, **_: (saved.append(figure), file.touch()))
    return saved


def styles_of(figure):
    """Return the color, marker, line style and fill of each label, in all panels."""
    lines = [line for panel in figure.axes for line in panel.get_lines()]
    return {
        (line.get_label(), line.get_color(), line.get_marker(), line.get_linestyle(), line.get_markerfacecolor())
        for line in lines
    }


def test_a_policy_has_one_style_in_all_panels_and_figures(tmp_path, drawings):
    """Also if others have no values in some panels: `stuck` solves nothing."""
    names, others = ([f"policy {number}{suffix}" for number in range(12)] for suffix in ("", " (published)"))
    tried, published = [], []
    for task, part in (("maze", slice(0, 6)), ("hall", slice(11, 5, -1)), ("yard", slice(0, 12, 3))):
        tried += episodes(task, [4, 8], "stuck", CSR=0.0, ISR=0.1)
        tried += episodes(task, [4, 8], *names[part], CSR=1.0, ISR=1.0, SoC_ratio=1.2)
        published += episodes(task, [4, 8], *others[part][:3], CSR=1.0, SoC_ratio=1.5)
    draw_figures(tried, tmp_path, published=published)
    assert [len(figure.axes) for figure in drawings] == [3, 3, 3]
    styles = set.union(*map(styles_of, drawings))
    labels = {"stuck", *names, *others[:3], *others[:8:-1], *others[0:9:3]}
    assert {label for label, *_ in styles} == labels
    assert len(styles) == len({tuple(style) for _, *style in styles}) == len(labels)
    for figure in drawings:
        legend = [text.get_text() for text in figure.legends[0].get_texts()]
        assert sorted(legend) == sorted({line.get_label() for panel in figure.axes for line in panel.get_lines()})


def test_many_policies_are_the_best_and_a_band_of_the_others(tmp_path, drawings):
    own = [each for k in range(8) for each in episodes("maze", [4, 8], f"own {k}", CSR=0.3 + k / 10, step_ms=1.0 + k)]
    published = [each for k in range(5) for each in episodes("maze", [4, 8], f"other {k}", CSR=k / 10)]
    draw_figures(own, tmp_path, published=published)
    quality, time = drawings[0].axes
    best = [f"own {k}" for k in range(3, 8)]
    assert {line.get_label() for line in quality.get_lines()} == {*best, "other 2", "other 3", "other 4"}
    assert {line.get_label() for line in time.get_lines()} == {*best}
    for panel, low, high in ((quality, 0.0, 0.5), (time, 1.0, 3.0)):
        (band,) = [each for each in panel.collections if each.get_label().startswith("the others")]
        ((vertices, _),) = [(path.vertices, path.codes) for path in band.get_paths()]
        scale = 11 / 18  # the mean of the episodes' values: see `episodes`
        assert sorted({*vertices[:, 1].round(6)}) == pytest.approx([low * scale, high * scale], abs=1e-6)
    assert drawings[0].legends[0].get_texts()[-1].get_text() == "the others, from minimum to maximum"


def test_intervals_of_policies_do_not_cover_each_other(tmp_path, drawings):
    draw_figures(episodes("maze", [4, 8, 64], *"abcdefghij", CSR=1.0), tmp_path)
    (panel,) = drawings[0].axes
    places = [segment[0, 0] for lines in panel.collections for segment in lines.get_segments()]
    assert len(set(places)) == 30
    assert all(min(abs(place - count) for count in (4, 8, 64)) < 2 for place in places)


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


def test_performance_profiles_of_methods(tmp_path, drawings):
    """Policies of one method are its runs; scores are 1, 0.5 and 0.25 times 0.611, the mean of 1, 1/2 and 1/3."""
    tried = [one for k in range(2) for one in episodes("maze", [4, 8], f"s/{k}", CSR=1.0 / (1 + k))]
    tried += episodes("maze", [4, 8], "pibt", CSR=0.25)
    assert draw_overview(tried, tmp_path, methods={"mine": "s/*"}) == [tmp_path / "performance-profiles.png"]
    [panel] = drawings[0].axes
    lines = {line.get_label(): line.get_ydata() for line in panel.get_lines()}
    mean = (1 + 1 / 2 + 1 / 3) / 3
    assert lines["mine"].tolist() == ((mean > THRESHOLDS) / 2 + (mean / 2 > THRESHOLDS) / 2).tolist()
    assert lines["pibt"].tolist() == (mean / 4 > THRESHOLDS).astype(float).tolist()


def test_scores_by_suite(tmp_path, drawings):
    mazes = [replace(one, suite="mazes/1 ab") for one in episodes("maze", [4], "pibt", "mine", CSR=0.5)]
    halls = [replace(one, suite="halls/2 cd") for one in episodes("hall", [4, 8], "pibt", CSR=1.0)]
    lifelong = episodes("yard", [4], "pibt", avg_throughput=3.0)
    files = draw_overview([*mazes, *halls, *lifelong], tmp_path / "new", format="svg")
    assert files == [tmp_path / "new" / f"{name}.svg" for name in ("performance-profiles", "suites")]
    shares, throughput = drawings[1].axes
    assert [text.get_text() for text in shares.get_xticklabels()] == ["mazes", "halls"]
    assert [text.get_text() for text in throughput.get_xticklabels()] == ["yard"]
    points = {line.get_label(): line.get_xydata().round(3).tolist() for line in shares.get_lines()}
    assert points == {"pibt": [[-0.15, 0.306], [0.85, 0.611]], "mine": [[0.15, 0.306]]}


def test_no_overview_of_one_task(tmp_path, drawings):
    assert draw_overview(episodes("maze", [4], "pibt", CSR=0.5), tmp_path) == []
    assert drawings == []
