// The functions that this page has open: their latest messages, and lines of their numbers.

import { numbersOf, Series } from "./numbers.js";

const MOST_LINES = 48; // names may differ from message to message
const RATE_OVER = 5; // seconds

export class Watches {
  constructor(wire, changed, now = () => performance.now() / 1000) {
    this.wire = wire;
    this.changed = changed;
    this.now = now;
    this.byName = new Map();
    this.byConnection = new Map();
  }

  /** Opens a function, or one output of it; rejects with a Refusal. */
  async open(name, options) {
    this.#forget(name);
    const opened = await this.wire.ask("Request", name, options);
    const watch = {
      name,
      connection: opened.connection,
      components: opened.components,
      inputs: opened.inputs,
      warnings: opened.warnings,
      latest: undefined,
      taken: 0,
      arrivals: [],
      series: new Map(),
      end: null,
      note: "",
    };
    this.byName.set(name, watch);
    this.byConnection.set(watch.connection, watch);
    this.changed();
    return watch;
  }

  async close(name) {
    const watch = this.byName.get(name);
    this.#forget(name);
    this.changed();
    if (watch && !watch.end) await this.wire.ask("Kill", watch.connection);
  }

  take(connection, message) {
    const watch = this.byConnection.get(connection);
    if (!watch) return;
    const now = this.now();
    watch.latest = message;
    watch.taken += 1;
    watch.arrivals.push(now);
    while (watch.arrivals[0] < now - RATE_OVER) watch.arrivals.shift();
    for (const [path, value] of numbersOf(message)) {
      if (!watch.series.has(path) && watch.series.size < MOST_LINES) watch.series.set(path, new Series());
      watch.series.get(path)?.add(now, value);
    }
    this.changed();
  }

  ended({ connection, state, cause }) {
    this.#end(this.byConnection.get(connection), state, cause);
  }

  refused(connection, { text }) {
    const watch = this.byConnection.get(connection);
    if (watch) watch.note = text;
    this.changed();
  }

  broken() {
    for (const one of this.byConnection.values()) {
      this.#end(one, "closed", "the connection to the server broke");
    }
  }

  rate(watch) {
    const { arrivals } = watch;
    const time = arrivals.at(-1) - arrivals[0];
    return arrivals.length > 1 && time > 0 ? (arrivals.length - 1) / time : null;
  }

  #end(watch, state, cause) {
    if (!watch || watch.end) return;
    watch.end = { state, cause };
    this.byConnection.delete(watch.connection);
    this.changed();
  }

  #forget(name) {
    const watch = this.byName.get(name);
    this.byName.delete(name);
    if (watch) this.byConnection.delete(watch.connection);
  }
}
