// Sets of cells [row, column]: lines, rectangles, and regions of equal cells.

// The cells of a path of moves to adjacent cells, from one cell to another.
function cellsBetween([fromRow, fromCol], [toRow, toCol]) {
  const rows = Math.abs(toRow - fromRow), cols = Math.abs(toCol - fromCol);
  const down = Math.sign(toRow - fromRow), right = Math.sign(toCol - fromCol), cells = [[fromRow, fromCol]];
  for (let row = 0, col = 0; row + col < rows + cols;) {
    // The next border of the line is between rows or between columns, whichever is crossed first.
    if ((2 * row + 1) * cols < (2 * col + 1) * rows) row++; else col++;
    cells.push([fromRow + down * row, fromCol + right * col]);
  }
  return cells;
}

function cellsOfRectangle([rowA, colA], [rowB, colB]) {
  const cells = [];
  for (let row = Math.min(rowA, rowB); row <= Math.max(rowA, rowB); row++)
    for (let col = Math.min(colA, colB); col <= Math.max(colA, colB); col++) cells.push([row, col]);
  return cells;
}

// The region of free cells, or of obstacles, that a cell belongs to.
function regionOf(drawing, [row, col]) {
  const kind = drawing.free[row * drawing.width + col], seen = new Uint8Array(drawing.free.length), cells = [[row, col]];
  seen[row * drawing.width + col] = 1;
  for (let k = 0; k < cells.length; k++)
    for (const [down, right] of HEADING_STEPS) {
      const next = [cells[k][0] + down, cells[k][1] + right], number = drawing.number(next);
      if (!drawing.isInside(...next) || seen[number] || drawing.free[number] !== kind) continue;
      seen[number] = 1;
      cells.push(next);
    }
  return cells;
}

// The number of the connected region of each free cell; -1 for obstacles.
function regionNumbers({ free, height, width }) {
  const numbers = new Int32Array(free.length).fill(-1), stack = new Int32Array(free.length);
  let regions = 0;
  for (let first = 0; first < free.length; first++) {
    if (!free[first] || numbers[first] >= 0) continue;
    let size = 0;
    const reach = (cell) => { if (free[cell] && numbers[cell] < 0) { numbers[cell] = regions; stack[size++] = cell; } };
    reach(first);
    while (size) {
      const cell = stack[--size], col = cell % width;
      if (col + 1 < width) reach(cell + 1);
      if (cell + width < height * width) reach(cell + width);
      if (col > 0) reach(cell - 1);
      if (cell >= width) reach(cell - width);
    }
    regions++;
  }
  return numbers;
}
