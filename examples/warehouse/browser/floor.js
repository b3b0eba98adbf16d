// The floor as the layout of the warehouse has it: nodes 1.5 m apart.

const PITCH = 1.5;
const COLUMNS = 8;
const ROWS = 5;
const RACKS = [[2, 3], [3, 3], [5, 3], [6, 3]];

export const SHELVES = [1, 2, 3, 4].map((number) => [`shelf${number}`, 2 * number, ROWS + 1]);
export const DOCKS = [1, 2].map((number) => [`dock${number}`, COLUMNS + 1, 2 * number]);
const HOMES = [1, 2, 3, 4].map((number) => [`home${number}`, 0, number]);
const EDGE = [...SHELVES, ...DOCKS, ...HOMES];

/** The position of a node in metres. */
export function position(name) {
  const found = EDGE.find(([edge]) => edge === name);
  const [column, row] = found ? found.slice(1) : [Number(name[1]), Number(name[2])];
  return [column * PITCH, row * PITCH];
}

function shape(kind, attributes, text) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", kind);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

/** Draw what never changes; return where vehicles are to be drawn. */
export function drawFloor(svg) {
  for (const [column, row] of RACKS) {
    svg.append(shape("rect", { class: "rack", x: column * PITCH - 0.5, y: -row * PITCH - 0.5, width: 1, height: 1 }));
  }
  for (const [name] of EDGE) {
    const [x, y] = position(name);
    svg.append(shape("rect", { class: "place", x: x - 0.6, y: -y - 0.6, width: 1.2, height: 1.2 }));
    svg.append(shape("text", { class: "place-name", x, y: -y + 0.52 }, name));
  }
  const vehicles = shape("g", {});
  svg.append(vehicles);
  return vehicles;
}

/** Draw a vehicle, and the way that it holds. */
export function drawVehicle({ name, x, y, heading, load, way, condition }) {
  const group = shape("g", { class: `vehicle ${condition}` });
  if (way.length > 1) {
    const points = way.map((node) => position(node)).map(([a, b]) => `${a},${-b}`);
    group.append(shape("polyline", { class: "way", points: points.join(" ") }));
  }
  const turned = shape("g", { transform: `translate(${x} ${-y}) rotate(${(-heading * 180) / Math.PI})` });
  turned.append(shape("circle", { r: 0.45 }), shape("path", { d: "M 0 0 H 0.42" }));
  if (load) turned.append(shape("rect", { class: "box", x: -0.28, y: -0.28, width: 0.5, height: 0.56 }));
  group.append(turned, shape("text", { class: "name", x, y: -y - 0.55 }, name));
  return group;
}
