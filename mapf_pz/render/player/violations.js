// The violations of the rules in a plan: each is a link to its step.

const MOST_LISTED = 500;

// `open` is called with the step and the agent of a link.
function listViolations(section, episodes, captions, open) {
  const checked = episodes.map((episode, k) => [episode, captions[k]]).filter(([episode]) => episode.violations);
  section.hidden = !checked.length;
  const found = checked.flatMap(([episode, caption]) => episode.violations.map((violation) => [violation, caption]));
  section.classList.toggle("legal", !found.length);
  section.querySelector("h2").textContent = found.length ? `Violations: ${found.length}` : "No violations of the rules";
  const several = episodes.length > 1;
  const items = found.slice(0, MOST_LISTED).map(([violation, caption]) => {
    const link = document.createElement("a"), item = document.createElement("li");
    link.href = address(violation.step, violation.agents[0] ?? -1);
    link.dataset.step = violation.step;
    link.onclick = (event) => { event.preventDefault(); open(violation.step, violation.agents[0] ?? -1); };
    link.textContent = `${several ? `${caption}: ` : ""}${violation.text}`;
    item.append(link);
    return item;
  });
  const others = found.length - MOST_LISTED;
  if (others > 0) items.push(Object.assign(document.createElement("li"), { textContent: `and ${others} more` }));
  section.querySelector("ol").replaceChildren(...items);
}

function markCurrentViolations(section, step) {
  for (const link of section.querySelectorAll("a"))
    if (Number(link.dataset.step) === step) link.setAttribute("aria-current", "step");
    else link.removeAttribute("aria-current");
}
