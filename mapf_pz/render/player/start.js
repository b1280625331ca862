// Starts the player with the episodes in the element `data`.

(async () => {
  const data = JSON.parse($("data").textContent), episodes = [];
  for (const episode of data.episodes) {
    const arrays = await unpackAll(episode.arrays, episode.steps + 1);
    episodes.push(new Episode(episode, arrays));
  }
  window.player = new Player(episodes, data.speed);
  document.body.dataset.ready = "yes";
})();
