// Keyboard control. Keys that the focused control uses itself are left to it.

const PAN = 60; // px

function bindKeys(player, signal) {
  const shifted = {
    ArrowLeft: () => player.pan(PAN, 0), ArrowRight: () => player.pan(-PAN, 0),
    ArrowUp: () => player.pan(0, PAN), ArrowDown: () => player.pan(0, -PAN),
  };
  const plain = {
    " ": () => player.play(!player.playing), ArrowLeft: () => player.seekBy(-1), ArrowRight: () => player.seekBy(1),
    Home: () => player.seekBy(-Infinity), End: () => player.seekBy(Infinity),
    0: () => player.fit(), "+": () => player.zoom(1.25), "-": () => player.zoom(0.8),
    "[": () => player.chooseNext(-1), "]": () => player.chooseNext(1), Escape: () => player.choose(-1),
    f: () => player.controls.toggle("follow"), d: () => player.toggleTheme(),
  };
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || usesKey(event.target, event.key)) return;
    const action = (event.shiftKey && shifted[event.key]) || plain[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }, { signal });
}

function usesKey(target, key) {
  if (target.matches("select, input[type=number]")) return key !== "Escape";
  if (target.matches("input[type=range]")) return /^(Arrow|Home|End|Page)/.test(key);
  return target.matches("button, summary, a, input[type=checkbox]") && key === " ";
}
