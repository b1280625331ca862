import numpy as np
import pytest

from mapf_pz.wrappers import ACTION_MODES

SAMPLING = ["affine", "sigmoid", "softmax"]
DRAWS = 40_000


def rng(seed=0):
    return np.random.default_rng(seed)


def frequencies(mode, values):
    """How often each action was drawn of `values` (A,)."""
    actions = ACTION_MODES[mode](np.tile(np.array(values, np.float64), (DRAWS, 1)), rng())
    return np.bincount(actions, minlength=len(values)) / DRAWS


def test_argmax_takes_the_first_of_the_largest():
    values = np.array([[0.1, 0.9, -1, 0], [0.5, 0.5, 0.5, 0.5], [-1, -0.9, -0.9, -1]])
    generator = rng()
    before = generator.bit_generator.state
    assert ACTION_MODES["argmax"](values, generator).tolist() == [1, 0, 1]
    assert generator.bit_generator.state == before


@pytest.mark.parametrize(
    ("mode", "weights"),
    [
        ("affine", lambda a: (a + 1) / 2),
        ("sigmoid", lambda a: (1 / (1 + np.exp(-a)) + 1) / 2),
        ("softmax", np.exp),
    ],
)
def test_actions_are_drawn_in_proportion_to_the_weights(mode, weights):
    values = np.array([-1.0, -0.3, 0.2, 1.0, 0.0])
    expected = weights(values) / weights(values).sum()
    assert frequencies(mode, values) == pytest.approx(expected, abs=0.01)


def test_affine_can_be_certain():
    assert frequencies("affine", [-1, -1, 1, -1]).tolist() == [0, 0, 1, 0]
    assert frequencies("affine", [-1, -1, -1, -0.999]).tolist() == [0, 0, 0, 1]
    assert frequencies("affine", [-1, 0, 0, -1])[[0, 3]].tolist() == [0, 0]


def test_affine_of_all_minus_one_is_uniform():
    assert frequencies("affine", [-1, -1, -1, -1]) == pytest.approx([0.25] * 4, abs=0.01)


def test_the_printed_formula_cannot_choose():
    # (sigmoid(1) + 1) / 2 = 0.8655 against three times (sigmoid(-1) + 1) / 2 = 0.6345, and the other way round.
    assert frequencies("sigmoid", [1, -1, -1, -1]) == pytest.approx([0.3126, 0.2291, 0.2291, 0.2291], abs=0.01)
    assert frequencies("sigmoid", [-1, 1, 1, 1])[0] == pytest.approx(0.1964, abs=0.01)
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 4)).reshape(4, -1).T
    weights = (1 / (1 + np.exp(-corners)) + 1) / 2
    shares = weights / weights.sum(axis=1, keepdims=True)
    assert shares.max() == pytest.approx(0.3126, abs=1e-4)
    assert shares.min() == pytest.approx(0.1964, abs=1e-4)


def test_softmax_chooses_at_most_so_much():
    assert frequencies("softmax", [1, -1, -1, -1])[0] == pytest.approx(0.7112, abs=0.01)


@pytest.mark.parametrize("mode", SAMPLING)
def test_draws_are_reproducible_and_in_range(mode):
    values = rng(1).uniform(-1, 1, (500, 4))
    first, again = (ACTION_MODES[mode](values.copy(), rng(7)) for _ in range(2))
    assert (first == again).all()
    assert (first != ACTION_MODES[mode](values.copy(), rng(8))).any()
    assert set(first.tolist()) == {0, 1, 2, 3}


@pytest.mark.parametrize("mode", ACTION_MODES)
def test_values_are_unchanged_and_there_may_be_no_agents(mode):
    values = np.full((3, 4), -1.0)
    ACTION_MODES[mode](values, rng())
    assert (values == -1).all()
    assert ACTION_MODES[mode](np.empty((0, 4)), rng()).shape == (0,)


class Extremes:
    """Draws the ends of [0, 1)."""

    def __init__(self, value):
        self.value = value

    def random(self, shape):
        return np.full(shape, self.value)


@pytest.mark.parametrize("value", [0.0, np.nextafter(1, 0)])
def test_weight_zero_is_never_drawn_at_the_ends(value):
    values = np.array([[-1, 0.1, 0.7, -1]])
    assert ACTION_MODES["affine"](values, Extremes(value))[0] in (1, 2)
