// What the page knows, in one place. Changes are reported once per frame.

import { mergeStatus, sinceStatus } from "../uoarm.js";
import { join } from "./system.js";
import { Watches } from "./watches.js";
import { Wire } from "./wire.js";

const EVERY = 1000;
const REST = 4; // times as long as drawing took, nothing is asked: it has a fifth of the time at most
const LONGEST_REST = 5000;
const MOST_EVENTS = 1000;
const NOTHING = { bridges: [], components: [], connections: [], routes: [], machines: [], own: [] };

export class Store {
  constructor(url, { isLocked, socket, frame = (act) => requestAnimationFrame(act) } = {}) {
    this.link = "opening";
    this.hello = null;
    this.functions = [];
    this.begun = false; // whether what this connection is asked first was answered
    this.loaded = false; // whether what there is has come at all
    this.status = NOTHING;
    this.events = [];
    this.since = new Date();
    this.owners = new Map(); // functions of connections, kept when these have ended
    this.trouble = null; // of the last stop or release
    this.approvals = { waiting: [], trouble: "", mayAsk: true }; // that this page may decide about
    this.system = join([], NOTHING);
    this.listeners = new Set();
    this.frame = frame;
    this.changing = false;
    this.looking = false; // whether what is asked every second was not answered yet
    this.rested = 0; // until when nothing is asked
    this.version = 0;
    this.wire = new Wire(url, (...report) => this.#receive(...report), { isLocked, socket });
    this.watches = new Watches(this.wire, () => this.changed());
  }

  listen(listener) {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }

  /** Notifies listeners in the next frame that something is different. */
  changed() {
    if (this.changing) return;
    this.changing = true;
    this.frame(() => {
      const begin = performance.now();
      this.changing = false;
      this.version += 1;
      for (const listener of this.listeners) listener(this.version);
      setTimeout(() => this.#drawn(begin), 0); // runs once the frame was drawn
    });
  }

  #drawn(begin) {
    const now = performance.now();
    this.rested = now + Math.min(REST * (now - begin), LONGEST_REST);
  }

  /** Asks for the status again, now. */
  async refresh() {
    const known = this.status;
    const report = await this.wire.ask("Status", "", { ...sinceStatus(known).jsonMessage, clients: true });
    this.#see(mergeStatus(known, report));
  }

  /** Asks what waits for a decision, for as long as the server lets this page ask. */
  async #askApprovals() {
    if (!this.approvals.mayAsk) return;
    try {
      const { approvals } = await this.wire.ask("Approve");
      this.approvals.waiting = approvals.filter(({ phase }) => phase === "pending");
    } catch (error) {
      if (error.code !== "closed") this.approvals.mayAsk = false;
    }
    this.changed();
  }

  /** Approves or refuses; what the server says against it is shown. */
  async decide(approval, decision) {
    try {
      await this.wire.ask("Approve", approval, decision);
      this.approvals.trouble = "";
    } catch (error) {
      this.approvals.trouble = error.message;
    }
    await this.#askApprovals();
  }

  unlock(token) {
    this.wire.token = token;
    this.link = "opening";
    this.wire.open();
    this.changed();
  }

  #receive(op, type, message) {
    if (op === "link") this.#linked(type, message);
    else if (op === "Data") this.watches.take(type, message);
    else if (op === "Status" && type === "connection") this.watches.ended(message);
    else if (op === "Status" && type === "change") this.#happened([{ ...message, age: 0 }]);
    else if (op === "Error") this.watches.refused(type, message);
  }

  #linked(link, hello) {
    this.link = link;
    clearInterval(this.timer);
    this.begun = false;
    if (link === "open") {
      this.timer = setInterval(() => this.#look(), EVERY);
      this.hello = hello;
      this.approvals.mayAsk = true;
      this.#begin().catch((error) => console.warn(error.message));
    } else {
      this.watches.broken();
    }
    this.changed();
  }

  async #begin() {
    const ask = (...asked) => this.wire.ask(...asked);
    const [list, status] = await Promise.all([ask("List"), ask("Status", "watch", { clients: true })]);
    this.functions = list.functions;
    this.loaded = true;
    this.events = [];
    this.#happened(status.past ?? []);
    this.#see(mergeStatus(null, status));
    this.#askApprovals();
    this.watches.again();
    this.begun = true;
  }

  #look() {
    if (document.hidden) return;
    this.wire.look();
    if (!this.begun || this.looking || performance.now() < this.rested) return;
    this.looking = true;
    Promise.all([this.refresh(), this.#askApprovals()])
      .catch((error) => console.warn(error.message))
      .finally(() => (this.looking = false));
  }

  #see(status) {
    this.status = status;
    if (this.trouble?.holds === (status.held != null)) this.trouble = null;
    this.watches.see(status);
    this.#keepOwners(status.connections);
    this.system = join(this.functions, status, this.events, this.hello?.session);
    this.changed();
  }

  /** Those that have ended longest ago are forgotten: no event is left of them. */
  #keepOwners(connections) {
    for (const { id, function: owner } of connections) {
      this.owners.delete(id); // so that it is the newest
      this.owners.set(id, owner);
    }
    for (const id of this.owners.keys()) {
      if (this.owners.size <= connections.length + MOST_EVENTS) break;
      this.owners.delete(id);
    }
  }

  #happened(report) {
    const now = Date.now();
    const fresh = report.filter((event) => !this.events.some((other) => other.number === event.number));
    for (const event of fresh) this.events.push({ ...event, at: new Date(now - event.age * 1000) });
    this.events = this.events.slice(-MOST_EVENTS);
    this.system = join(this.functions, this.status, this.events, this.hello?.session);
    this.changed();
  }
}
