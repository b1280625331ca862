// Mouse and touch on a view: drag or swipe to pan, wheel or pinch to zoom, click or tap to select an agent.

const STILL = 5; // px that a pointer may move during a click

class Pointer {
  constructor(player, view) {
    Object.assign(this, { player, view, down: new Map(), moved: false });
    const { canvas } = view;
    canvas.onwheel = (event) => {
      event.preventDefault();
      player.zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
    };
    canvas.onpointerdown = (event) => this.press(event);
    canvas.onpointermove = (event) => this.move(event);
    canvas.onpointerup = (event) => this.release(event);
    canvas.onpointercancel = (event) => this.down.delete(event.pointerId);
    canvas.onpointerleave = () => player.hint.hide();
  }

  press(event) {
    if (!this.down.size) this.moved = false;
    $("options").open = false; // they may cover the map
    this.down.set(event.pointerId, [event.offsetX, event.offsetY]);
    this.view.canvas.setPointerCapture(event.pointerId);
  }

  move(event) {
    const before = this.down.get(event.pointerId), after = [event.offsetX, event.offsetY];
    if (!before) { this.player.hint.show(this.view, ...after, this.player.time); return; }
    const [dx, dy] = [after[0] - before[0], after[1] - before[1]];
    if (!this.moved && this.down.size === 1 && Math.hypot(dx, dy) < STILL) return;
    this.moved = true;
    this.player.hint.hide();
    this.view.canvas.classList.add("dragging");
    const other = [...this.down].find(([id]) => id !== event.pointerId)?.[1];
    if (other) this.pinch(before, after, other); else this.player.pan(dx, dy);
    this.down.set(event.pointerId, after);
  }

  // Two fingers: the map keeps its places under both.
  pinch(before, after, other) {
    const distance = (a) => Math.max(1, Math.hypot(a[0] - other[0], a[1] - other[1]));
    this.player.pan((after[0] - before[0]) / 2, (after[1] - before[1]) / 2);
    this.player.zoom(distance(after) / distance(before), (after[0] + other[0]) / 2, (after[1] + other[1]) / 2);
  }

  release(event) {
    const place = this.down.get(event.pointerId);
    this.down.delete(event.pointerId);
    if (this.down.size) return;
    this.view.canvas.classList.remove("dragging");
    if (place && !this.moved) this.player.choose(this.view.agentAt(...place, this.player.time));
  }
}
