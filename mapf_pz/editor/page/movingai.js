// Writes the MovingAI benchmark's maps and scenarios, which mapfile.js reads.

function mapText({ height, width, free }) {
  const rows = [];
  for (let row = 0; row < height; row++)
    rows.push(Array.from(free.subarray(row * width, (row + 1) * width), (isFree) => (isFree ? "." : "@")).join(""));
  return `type octile\nheight ${height}\nwidth ${width}\nmap\n${rows.join("\n")}\n`;
}

function scenarioText(drawing, name) {
  const search = new OctileSearch(drawing), lines = ["version 1"];
  drawing.agents.forEach(({ start, goals }, agent) => {
    require(goals.length === 1, name, `expected one goal of agent ${agent}, got ${goals.length}: save a problem instead`);
    const distance = search.distance(start, goals[0]);
    require(distance < Infinity, name, `no path leads agent ${agent} from its start to its goal`);
    const ends = [...start.toReversed(), ...goals[0].toReversed()];
    const size = [`${drawing.name}.map`, drawing.width, drawing.height];
    lines.push([Math.floor(distance / 4), ...size, ...ends, distance.toFixed(8)].join("\t"));
  });
  return `${lines.join("\n")}\n`;
}

// The drawing of a map that parseMap returns, and its agents if there is a scenario.
function drawingOf(map, scenario = null) {
  const agents = (scenario?.starts ?? []).map((start, k) => Object.freeze({ start, goals: [scenario.goals[k]], heading: 0 }));
  return new Drawing({ name: map.name, height: map.height, width: map.width, free: map.free, agents });
}
