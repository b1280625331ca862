// The checkboxes that decide what is shown, and the choice of the cells' colors.

const SWITCHES = ["goals", "numbers", "blocked", "field", "ahead", "attention", "follow", "directions"];

class Controls {
  constructor(episodes, options, onChange) {
    const known = {
      goals: (episode) => episode.hasGoals(), blocked: (episode) => episode.hasBlocked,
      field: (episode) => episode.hasField(), directions: (episode) => episode.weights !== undefined,
      attention: (episode) => episode.attended !== undefined,
    };
    for (const name of SWITCHES) {
      const box = $(name);
      box.parentElement.hidden = known[name] !== undefined && !episodes.some(known[name]);
      options[name] = box.checked;
      box.onchange = () => { options[name] = box.checked; onChange(); };
    }
    const grounds = Object.entries(GROUNDS).filter(([, ground]) => episodes.some(ground.isKnown));
    $("ground").replaceChildren(...grounds.map(([name, ground]) => new Option(ground.label, name)));
    options.ground = "plain";
    $("ground").onchange = () => { options.ground = $("ground").value; onChange(); };
  }

  set(name, on) { if ($(name).checked !== on) $(name).click(); }
  toggle(name) { $(name).click(); }
}
