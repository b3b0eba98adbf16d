// The functions that this page has open: their latest messages, and lines of their numbers.

import { timeOf } from "./format.js";
import { numbersOf, Series } from "./numbers.js";
import { findPicture } from "./picture.js";

const MOST_LINES = 48; // names may differ from message to message
const RATE_OVER = 5; // seconds
const SILENT = 1; // seconds without a message, and
const MOST_RECENT = 16; // messages of what lies over a picture, and of the picture, while one lies over the other
const MOST_LETTERS = 32e6; // of these pictures
const LATE = 3; // messages that are late: then a rate is 0

export class Watches {
  constructor(wire, changed, now = () => (performance.timeOrigin + performance.now()) / 1000) {
    this.wire = wire;
    this.changed = changed;
    this.now = now;
    this.byName = new Map();
    this.byConnection = new Map();
    this.pairs = new Map(); // by picture: what lies over it
    this.overlays = new Map(); // by the picture that they lie over: what was opened for that alone
  }

  /** Opens a function, or one output of it; rejects with a Refusal. */
  async open(name, options) {
    const watch = {
      name,
      options,
      latest: undefined,
      recent: [], // { time, message, letters } of those that say when they are of, oldest first
      taken: 0,
      arrivals: [],
      series: new Map(),
      gaps: 0, // how often the connection to the server broke meanwhile
      away: false, // whether it is broken now
      end: null,
      note: "",
    };
    const opened = await this.wire.ask("Request", name, options);
    this.#forget(name);
    this.#is(watch, opened);
    return watch;
  }

  async close(name) {
    const watch = this.byName.get(name);
    this.#forget(name);
    this.changed();
    if (watch && !watch.end && !watch.away) await this.wire.ask("Kill", watch.connection);
  }

  /** Has one function's messages lie over the pictures of another; opens it where it is not watched. */
  async overlay(picture, name) {
    if (name) this.pairs.set(picture, name);
    else this.pairs.delete(picture);
    if (this.overlays.get(picture) === name) return;
    await this.#giveBack(picture);
    if (!name || this.byName.has(name)) return;
    this.overlays.set(picture, name);
    try {
      await this.open(name, { queue: { length: 4, policy: "drop-oldest" } });
    } catch (error) {
      this.overlays.delete(picture);
      throw error;
    }
  }

  /** Gives back what was opened to lie over a picture, unless it lies over another one, too. */
  async closeOverlay(picture) {
    this.pairs.delete(picture);
    await this.#giveBack(picture);
  }

  async #giveBack(picture) {
    const name = this.overlays.get(picture);
    this.overlays.delete(picture);
    if (name && ![...this.overlays.values()].includes(name)) await this.close(name);
  }

  take(connection, message) {
    const watch = this.byConnection.get(connection);
    if (!watch) return;
    const now = this.now();
    watch.latest = message;
    watch.taken += 1;
    this.#keep(watch, message);
    watch.arrivals.push(now);
    while (watch.arrivals[0] < now - RATE_OVER) watch.arrivals.shift();
    for (const [path, value] of numbersOf(message)) {
      if (!watch.series.has(path) && watch.series.size < MOST_LINES) watch.series.set(path, new Series());
      watch.series.get(path)?.add(now, value);
    }
    this.changed();
  }

  #keep(watch, message) {
    const isPaired = [...this.pairs].some((names) => names.includes(watch.name));
    const time = isPaired ? timeOf(message) : null;
    if (time === null) {
      watch.recent = [];
      return;
    }
    const picture = findPicture(message);
    watch.recent.push({ time, message, letters: (picture?.data ?? picture?.url ?? "").length });
    let letters = watch.recent.reduce((sum, item) => sum + item.letters, 0);
    while (watch.recent.length > MOST_RECENT || (letters > MOST_LETTERS && watch.recent.length > 1)) {
      letters -= watch.recent.shift().letters;
    }
  }

  ended({ connection, state, cause }) {
    this.#end(this.byConnection.get(connection), state, cause);
  }

  refused(connection, { text }) {
    const watch = this.byConnection.get(connection);
    if (watch) watch.note = text;
    this.changed();
  }

  /** Takes over from the status which components each goes through now. */
  see({ connections }) {
    for (const { id, components } of connections) {
      const watch = this.byConnection.get(id);
      if (watch) watch.components = components;
    }
  }

  broken() {
    for (const watch of this.byConnection.values()) watch.away = true;
    this.byConnection.clear();
    this.changed();
  }

  /** Opens again what was open when the connection broke; what was missed is not known. */
  async again() {
    const away = [...this.byName.values()].filter((watch) => watch.away && !watch.end);
    await Promise.all(away.map((watch) => this.#again(watch)));
  }

  async #again(watch) {
    try {
      const opened = await this.wire.ask("Request", watch.name, watch.options);
      if (this.byName.get(watch.name) === watch) {
        watch.away = false;
        watch.gaps += 1;
        for (const line of watch.series.values()) line.interrupt();
        this.#is(watch, opened);
      } else await this.wire.ask("Kill", opened.connection); // it was stopped meanwhile
    } catch (error) {
      if (error.code !== "closed") this.#end(watch, "failed", error.message); // else it is tried again
    }
  }

  /** Messages a second; 0 once several are late, as the robot has it for its flows. */
  rate(watch) {
    const { arrivals } = watch;
    const time = arrivals.at(-1) - arrivals[0];
    if (arrivals.length < 2 || time <= 0) return null;
    const every = time / (arrivals.length - 1);
    return this.now() - arrivals.at(-1) > Math.max(SILENT, LATE * every) ? 0 : 1 / every;
  }

  #is(watch, { connection, components, inputs, warnings }) {
    Object.assign(watch, { connection, components, inputs, warnings, note: "" }); // what was refused is over
    this.byName.set(watch.name, watch);
    this.byConnection.set(connection, watch);
    this.changed();
  }

  #end(watch, state, cause) {
    if (!watch || watch.end) return;
    const killed = state === "closed" && cause?.startsWith("killed ");
    watch.end = { state, cause: killed ? cause.slice("killed ".length) : cause, word: killed ? "killed" : state };
    this.byConnection.delete(watch.connection);
    this.changed();
  }

  #forget(name) {
    const watch = this.byName.get(name);
    this.byName.delete(name);
    if (watch) this.byConnection.delete(watch.connection);
  }
}
