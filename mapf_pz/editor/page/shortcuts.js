// Keyboard control of the editor. Keys that the focused control uses itself are left to it.

const SHORTCUTS = [
  // keys, what they do, and the function, which is given the editor and the keyboard's event
  ...Object.entries(TOOLS).map(([tool, { key, label }]) => [[key], `tool: ${label}`, (editor) => editor.set({ tool })]),
  [["ArrowUp"], "cursor up", (editor) => editor.moveCursor(-1, 0)],
  [["ArrowDown"], "cursor down", (editor) => editor.moveCursor(1, 0)],
  [["ArrowLeft"], "cursor to the left", (editor) => editor.moveCursor(0, -1)],
  [["ArrowRight"], "cursor to the right", (editor) => editor.moveCursor(0, 1)],
  [["Enter"], "press the tool at the cursor, or release it; with shift, as with the right button", pressAtCursor],
  [["Escape"], "end the tool's stroke without its changes, or select no agent", (editor) => (editor.stroke ? editor.cancel() : editor.set({ selected: -1 }))],
  [["ctrl+z"], "undo", (editor) => editor.undo()],
  [["ctrl+y", "ctrl+shift+z"], "redo", (editor) => editor.redo()],
  [["["], "previous agent", (editor) => editor.selectNext(-1)],
  [["]"], "next agent", (editor) => editor.selectNext(1)],
  [[","], "turn the selected agent to the left", (editor) => editor.turn(-1)],
  [["."], "turn the selected agent to the right", (editor) => editor.turn(1)],
  [["Delete", "Backspace"], "delete the selected agent", (editor) => editor.deleteSelected()],
  [["+"], "larger", (editor) => zoom(editor, 1.25)],
  [["-"], "smaller", (editor) => zoom(editor, 0.8)],
  [["0"], "whole map", (editor) => { editor.board.camera.fit(); editor.refresh(); }],
  [["d"], "light or dark colors", (editor) => editor.setTheme(editor.theme === "dark" ? "light" : "dark")],
];

function pressAtCursor(editor, event) {
  editor.hasCursor = true;
  if (editor.stroke) editor.release();
  else editor.press(editor.cursor, event.shiftKey);
  if (editor.stroke && !TOOLS[editor.tool].drag) editor.release();
}

function zoom(editor, factor) { editor.board.camera.zoom(factor); editor.refresh(); }

function bindShortcuts(editor) {
  const actions = new Map(SHORTCUTS.flatMap(([keys, , action]) => keys.map((key) => [key, action])));
  addEventListener("keydown", (event) => {
    const isText = event.target.matches("input:not([type]), input[type=file]"), hasControl = event.ctrlKey || event.metaKey;
    if ($("drawing").hidden || event.altKey || isText || usesKey(event.target, event.key)) return;
    if (event.key === "Enter" && !event.target.matches("canvas, body")) return; // presses a button
    const isPrinted = event.key.length === 1 && !hasControl;
    const name = isPrinted ? event.key : `${hasControl ? "ctrl+" : ""}${hasControl && event.shiftKey ? "shift+" : ""}${event.key.length === 1 ? event.key.toLowerCase() : event.key}`;
    const action = actions.get(name);
    if (!action) return;
    event.preventDefault();
    action(editor, event);
  });
  $("editor-keys").querySelector("table").replaceChildren(...SHORTCUTS.map(([keys, what]) => line(keys.join(" "), [what])));
}
