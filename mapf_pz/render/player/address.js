// Steps as links: `#t=20&agent=3` is step 20 with agent 3 selected.

const HAS_ADDRESS = location.protocol !== "about:"; // a page in a notebook has none
const ADDRESS_DELAY = 250; // ms; browsers limit how often an address may change

function address(step, agent) { return `#t=${step}${agent >= 0 ? `&agent=${agent}` : ""}`; }

// The step and the agent in an address; -1 for what it does not name.
function parseAddress(hash) {
  const values = new URLSearchParams(hash.slice(1));
  const number = (name) => (/^\d{1,9}$/.test(values.get(name) ?? "") ? Number(values.get(name)) : -1);
  return { step: number("t"), agent: number("agent") };
}

class AddressBar {
  write(step, agent) {
    if (!HAS_ADDRESS) return;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => history.replaceState(null, "", address(step, agent)), ADDRESS_DELAY);
  }
}
