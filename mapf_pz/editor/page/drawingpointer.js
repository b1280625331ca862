// Mouse and touch on the board: the tool, or moving the map with the middle button, with two fingers, or with the tool
// `move` where nothing is; the wheel zooms.

class DrawingPointer {
  constructor(editor) {
    Object.assign(this, { editor, down: new Map(), isPanning: false });
    const { canvas } = editor.board;
    canvas.onwheel = (event) => {
      event.preventDefault();
      editor.board.camera.zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
      editor.refresh();
    };
    canvas.oncontextmenu = (event) => event.preventDefault();
    canvas.onpointerdown = (event) => this.press(event);
    canvas.onpointermove = (event) => this.move(event);
    canvas.onpointerup = (event) => this.release(event);
    canvas.onpointercancel = (event) => { this.down.delete(event.pointerId); editor.cancel(); };
  }

  cell(event) {
    return this.editor.drawing.inside(this.editor.board.camera.at(event.offsetX, event.offsetY).map(Math.floor));
  }

  press(event) {
    const { editor } = this;
    editor.board.canvas.setPointerCapture(event.pointerId);
    this.down.set(event.pointerId, [event.offsetX, event.offsetY]);
    editor.hasCursor = false;
    this.isPanning = event.button === 1 || this.down.size > 1;
    if (this.isPanning) { editor.cancel(); return; }
    editor.press(this.cell(event), event.shiftKey || event.button === 2);
    this.isPanning = editor.tool === "move" && !editor.grabbed;
  }

  move(event) {
    const { editor } = this, before = this.down.get(event.pointerId);
    editor.set({ cursor: this.cell(event) });
    if (!before) return;
    if (this.isPanning) this.pan(event, before);
    else if (editor.stroke) editor.drag(editor.cursor);
    this.down.set(event.pointerId, [event.offsetX, event.offsetY]);
  }

  // One pointer moves the map; two also zoom, by the change of their distance.
  pan(event, [x, y]) {
    const { camera } = this.editor.board, now = [event.offsetX, event.offsetY];
    const other = [...this.down].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const distance = ([a, b]) => Math.max(1, Math.hypot(a - other[0], b - other[1]));
      camera.zoom(distance(now) / distance([x, y]), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    }
    camera.pan((now[0] - x) / this.down.size, (now[1] - y) / this.down.size);
    this.editor.refresh();
  }

  release(event) {
    this.down.delete(event.pointerId);
    if (!this.down.size) this.isPanning = false;
    this.editor.release();
  }
}
