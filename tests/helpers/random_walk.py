"""How agents walk in the recordings: half of the time towards their goals, so that they meet and arrive."""

WAIT, UP, DOWN, LEFT, RIGHT = range(5)  # POGEMA's numbers, and `CardinalAction`'s


def intended(draw, here, goal):
    """Return the action of an agent at `here` (row, col); `draw` is a `random.Random`, the same in all versions."""
    if draw.random() < 0.5:
        return int(draw.random() * 5)
    rows, cols = goal[0] - here[0], goal[1] - here[1]
    if rows and (not cols or draw.random() < 0.5):
        return DOWN if rows > 0 else UP
    if cols:
        return RIGHT if cols > 0 else LEFT
    return WAIT
