"""The pointer on the editor's page, in cells of the drawing."""


def at(page, row, col):
    """Return the position of a cell's center on the page."""
    return page.evaluate(
        """([row, col]) => {
            editor.resize();
            const box = $("board").getBoundingClientRect(), { left, top, scale } = editor.board.camera;
            return [box.left + left + (col + 0.5) * scale, box.top + top + (row + 0.5) * scale];
        }""",
        [row, col],
    )


def stroke(page, *cells, button="left"):
    """Press at the first cell, move over the others, and release."""
    page.mouse.move(*at(page, *cells[0]))
    page.mouse.down(button=button)
    for cell in cells[1:]:
        page.mouse.move(*at(page, *cell))
    page.mouse.up(button=button)
