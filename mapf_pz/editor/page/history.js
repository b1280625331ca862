// The drawings before and after the current one, for undo and redo.

const MOST_KEPT = 1000; // drawings
const MOST_KEPT_BYTES = 256e6; // of their maps and weights

class History {
  constructor(drawing) { Object.assign(this, { current: drawing, past: [], future: [] }); }

  add(drawing) {
    if (drawing === this.current) return;
    this.past.push(this.current);
    this.current = drawing;
    this.future = [];
    while (this.past.length > MOST_KEPT || (this.past.length > 1 && this.bytes() > MOST_KEPT_BYTES)) this.past.shift();
  }

  // Drawings share the arrays that an edit does not change.
  bytes() {
    const arrays = new Set(this.past.flatMap(({ free, weights }) => [free.buffer, ...(weights ? [weights.buffer] : [])]));
    return [...arrays].reduce((sum, array) => sum + array.byteLength, 0);
  }

  undo() {
    if (!this.past.length) return;
    this.future.push(this.current);
    this.current = this.past.pop();
  }

  redo() {
    if (!this.future.length) return;
    this.past.push(this.current);
    this.current = this.future.pop();
  }
}
