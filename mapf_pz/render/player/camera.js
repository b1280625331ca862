// Which part of the map is shown: `scale` pixels per cell, with the map's corner at (`left`, `top`).

const SMALLEST_SCALE = 0.05, LARGEST_SCALE = 96; // px per cell
const MARGIN = 8; // px around the whole map
const TOOLBAR = 30; // px above the whole map, for the buttons

class Camera {
  constructor(height, width) { // of the map, in cells
    Object.assign(this, { height, width, scale: 1, left: 0, top: 0, boxWidth: 1, boxHeight: 1 });
  }

  // Keeps the map's part in the center when the size of the view changes.
  resize(boxWidth, boxHeight) {
    this.left += (boxWidth - this.boxWidth) / 2;
    this.top += (boxHeight - this.boxHeight) / 2;
    Object.assign(this, { boxWidth, boxHeight });
    if (this.fits) this.fit();
  }

  fit() {
    const room = [(this.boxWidth - 2 * MARGIN) / this.width, (this.boxHeight - TOOLBAR - 2 * MARGIN) / this.height];
    this.scale = Math.max(Math.min(LARGEST_SCALE, ...room), SMALLEST_SCALE);
    this.left = (this.boxWidth - this.scale * this.width) / 2;
    this.top = (this.boxHeight + TOOLBAR - this.scale * this.height) / 2;
    this.fits = true;
  }

  zoom(factor, x = this.boxWidth / 2, y = this.boxHeight / 2) {
    const least = Math.min(this.boxWidth / this.width, this.boxHeight / this.height, 2) / 2;
    const scale = Math.max(least, Math.min(LARGEST_SCALE, this.scale * factor));
    this.left = x - ((x - this.left) * scale) / this.scale;
    this.top = y - ((y - this.top) * scale) / this.scale;
    this.scale = scale;
    this.fits = false;
  }

  pan(dx, dy) {
    this.left += dx;
    this.top += dy;
    this.fits = false;
  }

  center(row, col) {
    this.left = this.boxWidth / 2 - (col + 0.5) * this.scale;
    this.top = this.boxHeight / 2 - (row + 0.5) * this.scale;
    this.fits = false;
  }

  // The position [row, column] at a pixel; the center of cell [r, c] is at [r + 0.5, c + 0.5].
  at(x, y) { return [(y - this.top) / this.scale, (x - this.left) / this.scale]; }

  // Whether a cell is in sight, at least in part.
  sees(row, col) {
    const x = this.left + col * this.scale, y = this.top + row * this.scale;
    return x > -2 * this.scale && y > -2 * this.scale && x < this.boxWidth + this.scale && y < this.boxHeight + this.scale;
  }
}
