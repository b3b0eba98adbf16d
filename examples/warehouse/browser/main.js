// The warehouse in a browser: the floor with live positions, the orders, and a form for new ones.

import { connect } from "./uoarm.js";
import { DOCKS, SHELVES, drawFloor, drawVehicle } from "./floor.js";

const ROBOT = new URLSearchParams(location.search).get("robot") ?? `ws://${location.hostname}:9080/`;
const PAUSE = 2000;
const NAMES = /^transport/;
const $ = (id) => document.getElementById(id);
const vehicles = drawFloor($("floor"));
let robot;

function row(...cells) {
  const line = document.createElement("tr");
  for (const cell of cells) line.insertCell().textContent = cell;
  return line;
}

function show(picture) {
  const seen = picture.vehicles.map((one) => ({ ...one, name: one.name.replace(NAMES, "") }));
  vehicles.replaceChildren(...seen.map(drawVehicle));
  $("vehicles").replaceChildren(...seen.map((one) =>
    row(one.name, one.condition, `${Math.round(one.battery)} %`, one.load, one.order)));
  $("orders").replaceChildren(...picture.orders.map((one) => {
    const mass = one.mass ? `${one.mass.toFixed(2)} kg` : "";
    const why = one.why.replaceAll(/transport(?=\S)/g, "");
    const line = row(one.order, one.source, `${one.load} kg`, mass, one.status, why || one.vehicle.replace(NAMES, ""));
    line.lastElementChild.className = why ? "why" : "";
    return line;
  }));
  $("lamp").className = `lamp ${picture.lamp}`;
  $("lamp").setAttribute("aria-label", `lamp: ${picture.lamp}`);
  $("progress").textContent = `${picture.done} orders are done`;
}

$("place").elements.source.append(...SHELVES.map(([name]) => new Option(name)));
$("place").elements.target.append(...DOCKS.map(([name]) => new Option(name)));
$("place").addEventListener("submit", async (event) => {
  event.preventDefault();
  const { source, target, load } = event.target.elements;
  const order = `page-${Date.now().toString(36)}`;
  try {
    await robot.call("transport", { order, source: source.value, target: target.value, load: Number(load.value) });
    $("progress").textContent = `${order} is placed`;
  } catch (error) {
    $("progress").textContent = `It was not placed: ${error.message}`;
  }
});

for (;;) {
  try {
    robot = await connect(ROBOT);
    const pictures = await robot.request("floor", { queue: { policy: "latest" } });
    for await (const picture of pictures) show(picture);
  } catch (error) {
    $("progress").textContent = `The robot is not ready: ${error.message}`;
  } finally {
    robot?.close();
  }
  await new Promise((resolve) => setTimeout(resolve, PAUSE));
}
