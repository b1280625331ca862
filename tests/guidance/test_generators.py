"""Generated guidance graphs."""

import numpy as np
import pytest

from mapf_pz.guidance import GuidanceGraph, open_edges

FREE = np.array([[True, True, True], [True, False, True]])
INF = np.inf


def test_highways():
    graph = GuidanceGraph.highway(FREE, "\n>>v\n^@.\n", along=0.25, against=3)
    assert graph.move.tolist() == [
        [[0.25, 0.25, INF], [INF, INF, INF]],  # east
        [[3, INF, 0.25], [INF, INF, INF]],  # south
        [[INF, 3, 3], [INF, INF, INF]],  # west
        [[INF, INF, INF], [0.25, INF, 1]],  # north
    ]
    assert (graph.wait == 1).all()


@pytest.mark.parametrize(
    ("arrows", "message"),
    [
        (">>>", "arrows: expected 2 lines, got 1"),
        (">>>\n>>", "arrows: expected 3 characters in row 1, got 2"),
        (">>>\n>x>", r"arrows: expected one of >v<\^\.@T in \[row 1, col 1\], got 'x'"),
    ],
)
def test_malformed_arrows(arrows, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        GuidanceGraph.highway(FREE, arrows)


def test_traffic_by_its_formula():
    rng = np.random.default_rng(0)
    free = rng.random((5, 6)) < 0.8
    moves = rng.integers(0, 4, (4, 5, 6))
    graph = GuidanceGraph.traffic(free, moves, contraflow=2, congestion=3)
    edges = open_edges(free)
    steps = [(0, 1), (1, 0), (0, -1), (-1, 0)]
    ends = {(d, r, c): (r + steps[d][0], c + steps[d][1]) for d, r, c in np.argwhere(edges).tolist()}
    into = {cell: sum(moves[edge] for edge, end in ends.items() if end == cell) for cell in ends.values()}
    for (d, r, c), end in ends.items():
        used, opposite = moves[d, r, c], moves[(d + 2) % 4, end[0], end[1]]
        share = opposite / (used + opposite) if used + opposite else 0
        expected = 1 + 2 * share + 3 * into[end] / max(into.values())
        assert graph.move[d, r, c] == pytest.approx(expected)
    assert np.isinf(graph.move[~edges]).all()


def test_no_traffic_is_uniform():
    assert GuidanceGraph.traffic(FREE, np.zeros((4, 2, 3))) == GuidanceGraph.uniform(FREE)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"moves": np.ones((4, 3, 2))}, r"moves: expected the shape \(4, 2, 3\), got \(4, 3, 2\)"),
        ({"moves": np.full((4, 2, 3), -1)}, "moves: expected numbers 0 or more"),
        ({"contraflow": -1.0}, "contraflow: expected numbers 0 or more"),
        ({"congestion": np.nan}, "congestion: expected numbers 0 or more"),
    ],
)
def test_malformed_traffic(changes, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        GuidanceGraph.traffic(FREE, **{"moves": np.ones((4, 2, 3))} | changes)
