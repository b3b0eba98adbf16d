// A client of `uoarm serve` for browsers and Node, without dependencies. Types: uoarm.d.ts.
import { decode, encode, listOf } from "./uoarm-cbor.js";
import { Link, UoarmError, checkSeconds, checked, errorOf, later, opened, seconds } from "./uoarm-link.js";

export { UoarmError };

const HELD = 1024;
const HELD_OCTETS = 2 ** 26;
const DIAGNOSIS_SECONDS = 1;
const NO_SOCKET =
  "there is no WebSocket here: Node.js has it from version 22 on, from 20.10 on with " +
  "--experimental-websocket; or give connect a class, { WebSocket }";
const TOKEN = /^[\w!#$%&'*+.^`|~-]+$/; // what a subprotocol's name may have
const NO_URL =
  "expected a URL such as ws://robot:9080/; a page that came by https may open wss:// only";
const NO_TOKEN = "token: expected what `uoarm token` prints: no spaces, no line breaks";
const FORMS = {
  json: {
    protocol: "uoarm.v1.json", frame: "text", read: JSON.parse, write: (it) => JSON.stringify(it, inJson),
  },
  cbor: { protocol: "uoarm.v1.cbor", frame: "binary", read: decode, write: encode },
};

/** What JSON has no form for, as the protocol writes it: JSON.stringify makes null of NaN. */
function inJson(key, value) {
  const own = this[key]; // not yet what a Buffer of Node.js makes of itself
  if (ArrayBuffer.isView(own) || own instanceof ArrayBuffer) return listOf(own);
  const isBare = typeof value === "bigint" || (typeof value === "number" && !Number.isFinite(value));
  return isBare ? String(value) : value;
}

/**
 * Messages for one reader: waits for the next, ends once, and keeps the newest when it is slow: so
 * many at most, and so many octets, as they came.
 */
class Mailbox {
  #most;
  #waiting = [];
  #octets = 0;
  #readers = [];
  #end = null;

  constructor({ policy, length = HELD } = {}) {
    this.#most = policy === "latest" ? 1 : Math.min(length, HELD);
  }

  /** Adds an item; returns how many of the oldest were let go of for it. */
  put(item, octets = 0) {
    const reader = this.#readers.shift();
    if (reader) {
      reader.resolve({ value: item, done: false });
      return 0;
    }
    this.#waiting.push({ item, octets });
    this.#octets += octets;
    let gone = 0;
    while (this.#waiting.length > this.#most || (this.#waiting.length > 1 && this.#octets > HELD_OCTETS)) {
      this.#take();
      gone += 1;
    }
    return gone;
  }

  #take() {
    const { item, octets } = this.#waiting.shift();
    this.#octets -= octets;
    return item;
  }

  finish(error) {
    this.#end ??= { error };
    for (const reader of this.#readers.splice(0)) this.#settle(reader);
  }

  get isEmpty() {
    return !this.#waiting.length && !this.#end;
  }

  /** The next item; undefined where none came in so many seconds. */
  next(timeout = Infinity) {
    return new Promise((resolve, reject) => {
      const reader = { resolve, reject };
      if (this.#waiting.length) resolve({ value: this.#take(), done: false });
      else if (this.#end) this.#settle(reader);
      else {
        this.#readers.push(reader);
        if (timeout < Infinity) this.#limit(reader, timeout);
      }
    });
  }

  #limit(reader, timeout) {
    const { resolve, reject } = reader;
    const timer = later(() => {
      this.#readers.splice(this.#readers.indexOf(reader), 1);
      resolve();
    }, timeout);
    reader.resolve = (item) => {
      clearTimeout(timer);
      resolve(item);
    };
    reader.reject = (error) => {
      clearTimeout(timer);
      reject(error);
    };
  }

  #settle({ resolve, reject }) {
    if (this.#end.error) reject(this.#end.error);
    else resolve({ value: undefined, done: true });
  }
}

/** A command that is renewed until `stop`; `message` may be replaced meanwhile. Made by `hold`. */
export class HeldCommand {
  #over = false;
  #wake = () => {};
  #stop;

  constructor(message, period, send, stop) {
    this.message = message;
    this.#stop = stop;
    /** Resolves when it was stopped; rejects when it cannot be renewed any more, with the reason. */
    this.done = this.#renew(period, send);
    this.done.catch(() => {}); // who wants to know asks for it
  }

  /** Renew it no more, and have the input stopped. Once is enough; resolves when it has stopped. */
  stop() {
    if (!this.#over) {
      this.#over = true;
      this.#wake();
      this.stopped = this.#stop();
    }
    return this.stopped;
  }

  /** One message is under way at a time, so that a link that was down never brings up many. */
  async #renew(period, send) {
    while (!this.#over) {
      const due = seconds() + period;
      try {
        await send(this.message);
      } catch (error) {
        if (this.#over) break; // the stop came before what waited
        this.#over = true;
        throw error;
      }
      if (this.#over) break;
      await new Promise((wake) => {
        this.#wake = wake;
        later(wake, due - seconds());
      });
    }
    await this.stopped;
  }
}

/** One open function: `for await`, `send`, `hold`, `stop`, `kill`. */
export class Stream {
  #ask;
  #diagnose;
  #refusal = "";
  #mailbox;
  #last; // the number of the last message that came or is lost
  #away = true;
  lost = 0;
  gaps = -1;
  state = "open";
  cause = "";
  trouble = [];

  /** `request` opens it: of this server, and of the one after a restart. */
  constructor(request, ask, diagnose) {
    this.request = request;
    this.#mailbox = new Mailbox(request.jsonMessage?.queue ?? {});
    this.#ask = ask;
    this.#diagnose = diagnose;
  }

  /** Is a connection of this server from now on; the first time, or after a gap. */
  open({ connection, inputs, output, warnings, lifetimes = {}, number }) {
    Object.assign(this, { connection, inputs, output, warnings, lifetimes });
    this.gaps += 1;
    this.#last = number;
    this.#away = false;
  }

  /** Sends nothing until it is open again: its name may be another connection's by then. */
  suspend() {
    this.#away = true;
  }

  [Symbol.asyncIterator]() {
    return { next: () => this.#next(), return: async () => {
      await this.kill();
      return { value: undefined, done: true };
    } };
  }

  /**
   * The next message, or undefined when no more will come. Where none came in `timeout` seconds it
   * rejects, and `trouble` says what keeps messages from coming, as far as the server says it soon.
   */
  async get({ timeout } = {}) {
    let item = await this.#next(checkSeconds("timeout", timeout ?? Infinity));
    if (item === undefined) {
      const trouble = timeout > 0 ? await this.#diagnose(this.connection) : [];
      if (this.#mailbox.isEmpty) {
        const last = `the server could not send the last message: ${this.#refusal}`;
        this.trouble = this.#refusal ? [...trouble, last] : trouble;
        const text = [`no message within ${timeout} s`, ...this.trouble].join("; ");
        throw new UoarmError("timeout", text);
      }
      item = await this.#mailbox.next(); // it came meanwhile
    }
    this.trouble = [];
    return item.value;
  }

  async #next(seconds) {
    if (this.output === null) throw new UoarmError("usage", `function ${this.request.type} has no output to read`);
    return this.#mailbox.next(seconds);
  }

  /** Hand one message to an input; resolves when the server has taken it. */
  async send(message, input, { takeOver = false } = {}) {
    const more = takeOver ? { "x-take-over": true } : {};
    if (Object.keys(this.lifetimes).length) more["x-sent"] = seconds(); // too late, it is refused there
    await this.#ask({ op: "Data", type: this.#there(input), jsonMessage: message, ...more });
  }

  /** Have an input stopped, and give its lease back; what was sent before and waits is discarded. */
  async stop(input) {
    await this.#ask({ op: "Stop", type: this.#there(input) });
  }

  /**
   * Renew a command until `stop` of what is returned is called, as while a button is held. The
   * period is in seconds; it is a quarter of the command's lifetime where none is given.
   */
  hold(message, { input, period, takeOver = false } = {}) {
    const name = input ?? (this.inputs.length === 1 ? this.inputs[0] : "default");
    const lifetime = this.lifetimes[name];
    if (lifetime !== undefined && period >= lifetime) {
      const lives = `commands live for ${lifetime} s, and are renewed every ${period} s`;
      console.warn(`${this.#type(input)}: ${lives}: it stops in between`);
    }
    const send = async (command) => {
      const options = { takeOver };
      takeOver = false; // who was taken over from does not take it back by itself
      await this.send(command, input, options);
    };
    const seconds = checkSeconds("period", period ?? (lifetime === undefined ? 0.1 : lifetime / 4));
    return new HeldCommand(message, seconds, send, () => this.stop(input));
  }

  /** Give the function back. Once is enough. */
  async kill() {
    if (this.state !== "open") return;
    this.finish("closed", "");
    if (this.#away) return;
    try {
      await this.#ask({ op: "Kill", type: this.connection });
    } catch (error) {
      // Otherwise it has ended at the server, too; `unknown`: before the Kill came there.
      if (!["closed", "unknown"].includes(error.code)) throw error;
    }
  }

  #type(input) {
    return input === undefined ? this.connection : `${this.connection}.${input}`;
  }

  #there(input) {
    if (!this.#away) return this.#type(input);
    const gone = `the server of ${this.connection} has gone, and has not opened it again yet`;
    throw new UoarmError("closed", `${gone}: nothing was sent`);
  }

  take(number, message, octets) {
    if (number) this.settle(number - 1);
    if (number) this.#last = number;
    this.lost += this.#mailbox.put(message, octets);
  }

  /** Take in that the server had a message that it could not write. */
  refuse(why) {
    this.#refusal = why;
  }

  /** Count what is missing up to a message, of which none will come any more. */
  settle(number) {
    if (number > this.#last) this.#refusal = ""; // it was of one of these
    this.lost += number - (this.#last ?? number);
    this.#last = number;
  }

  finish(state, cause, number = null) {
    if (this.state === "open" && number !== null) this.settle(number);
    if (this.state === "open") Object.assign(this, { state, cause });
    this.#mailbox.finish(this.state === "failed" ? new UoarmError("closed", this.cause) : null);
  }
}

const CHANGE = { number: "number", time: "number", subject: "text", change: "text", cause: "text", function: "text" };
const NOTICES = {
  hello: { "message_bytes?": "number|null" },
  connection: { connection: "text", state: "text", cause: "text", number: "number" },
  change: CHANGE,
};
const ENTRIES = {
  components: { name: "text", health: "text", cause: "text", last_error: "text" },
  connections: { id: "text", components: ["text"], state: "text", cause: "text" },
  routes: { producer: "text", consumer: "text", age: "number|null", "refusal?": "text" },
};
const APPROVAL = { approval: "text", phase: "text", requester: "text", function: "text", digest: "text" };
const RECORDING = { recording: "text", state: "text", files: ["text"] };
const PLAYER = { bridge: "text", functions: ["text"], may_move: "boolean", cause: "text" };
const REVISION = { revision: "number", differences: ["text"], text: "text" };
// By the question: its op, and what it has that makes it another one. A service replies anything.
const ANSWERS = {
  Request: {
    connection: "text", inputs: ["text"], "output?": "text|null", warnings: ["text"],
    "lifetimes?": { "*": "number" }, "number?": "number|null",
  },
  List: {
    functions: [{
      name: "text", description: "text", service: "boolean", outputs: ["text"], inputs: ["text"],
      components: [{ name: "text", bridge: "text", priority: "number" }],
    }],
  },
  Resolve: { plan: { steps: [{ component: { name: "text" }, structures: "object" }] }, text: "text" },
  Configure: { revisions: [REVISION] },
  "Configure text": REVISION,
  "Configure rollback": REVISION,
  "Configure schema": { schema: "object" },
  Discover: { bridges: ["object"] },
  "Discover take": { text: "text" },
  Approve: { approvals: [APPROVAL] },
  "Approve type": APPROVAL,
  Record: { recordings: [RECORDING] },
  "Record functions": RECORDING,
  "Record type": RECORDING,
  Play: { players: [PLAYER] },
  "Play type": PLAYER,
  Stop: { stopped: "boolean", inputs: ["object"], text: "text" },
  "Stop type": "any",
  "Stop release": "any",
};

/** Returns what answers a question, where it is what the protocol says; throws where it is not. */
function checkedAnswer({ op, type, jsonMessage }, answer) {
  if (op === "Status") return checked(answer, statusShape(answer), "the server's Status");
  if (!ANSWERS[op]) return answer;
  const kinds = [...(type ? ["type"] : []), ...Object.keys(jsonMessage ?? {})].map((name) => `${op} ${name}`);
  return checked(answer, ANSWERS[kinds.find((kind) => ANSWERS[kind]) ?? op], `the server's Reply to ${op}`);
}

function statusShape(answer) {
  const isPartial = answer?.since !== undefined;
  const shape = isPartial ? { elapsed: "number" } : {};
  for (const [part, entry] of Object.entries(ENTRIES)) {
    const isChange = isPartial && !Array.isArray(answer[part]);
    const key = part === "routes" ? ["text"] : "text";
    shape[`${part}?`] = isChange ? { "changed?": [entry], "gone?": [key] } : [entry];
  }
  return shape;
}

const KEYS = {
  components: (entry) => entry.name,
  connections: (entry) => entry.id,
  routes: (entry) => JSON.stringify([entry.producer, entry.consumer]),
};

/** What asks for the changes since the status that is known, to be put into a `Status`. */
export function sinceStatus(known) {
  return known?.version === undefined ? {} : { jsonMessage: { since: known.version } };
}

/** The whole status, of the one that is known and the changes since then. */
export function mergeStatus(known, { since, elapsed, ...received }) {
  if (since === undefined) return received;
  const status = { ...known, ...received };
  for (const [part, keyOf] of Object.entries(KEYS)) {
    if (Array.isArray(received[part])) continue;
    const { changed = [], gone = [] } = received[part] ?? {};
    const entries = new Map((known?.[part] ?? []).map((entry) => [keyOf(entry), entry]));
    if (part === "routes") {
      for (const [key, route] of entries) {
        if (route.age !== null) entries.set(key, { ...route, age: route.age + elapsed });
      }
    }
    for (const key of gone) entries.delete(Array.isArray(key) ? JSON.stringify(key) : key);
    for (const entry of changed) entries.set(keyOf(entry), entry);
    status[part] = [...entries.values()];
  }
  return status;
}

/**
 * What keeps messages of a connection from coming, of the whole status: for what it waits, which of
 * its components is not well, and why the last message between them was not taken.
 */
export function findTrouble({ connections = [], components = [], routes = [] }, connection) {
  const own = connections.find(({ id }) => id === connection);
  if (!own) return [];
  const names = new Set(own.components);
  const causes = own.cause ? [`the connection is ${own.state}: ${own.cause}`] : [];
  for (const { name, health, cause, last_error: last } of components) {
    if (names.has(name) && health !== "ok") causes.push(`${name} is ${health}: ${cause || last}`);
  }
  for (const { producer, consumer, refusal } of routes) {
    const component = consumer.slice(0, Math.max(0, consumer.lastIndexOf(".")));
    const isOwn = consumer === connection || names.has(component);
    if (isOwn && refusal && !causes.some((text) => text.includes(refusal))) {
      causes.push(`the last message of ${producer} -> ${consumer} was refused: ${refusal}`);
    }
  }
  return causes;
}

/** A robot behind a server; made by `connect`. */
export class Robot {
  #link;
  #asked = new Map();
  #streams = new Map();
  #away = new Set(); // streams of a session that is gone, until this one has opened them again
  #watchers = new Set();
  #status = null;
  #next = 1;
  #ended = null;
  #answer;
  #place;
  #another;
  #abandoned = new Set(); // Requests without an answer in time: what they open is given back

  constructor({ answer, place = "the server", ...options }) {
    this.hello = null;
    this.#answer = answer;
    this.#place = place;
    this.#another = () => new Robot({ answer, place, ...options, resume: false, reconnect: 0 });
    this.#link = new Link({
      ...options,
      place,
      take: (received, octets) => this.#take(received, octets),
      lost: (error) => this.#lose(error),
      begun: () => this.#openAgain(),
      wentOn: (own) => this.#settle(own),
      ended: (error) => this.#finish(error),
    });
  }

  /** How often the connection dropped and the session went on over another. */
  get resumed() {
    return this.#link.resumed;
  }

  /** How often the session was gone and a new one was begun, as `reconnect` says. */
  get restarts() {
    return this.#link.restarts;
  }

  /** Connect; `connect` does it. */
  async start() {
    await this.#link.start();
    return this;
  }

  /** Open a function, or `function.output`. */
  async request(name, options = {}) {
    return this.#ask({ op: "Request", type: name, jsonMessage: options });
  }

  /** Call a service; `timeout` in seconds. */
  async call(name, message, { timeout } = {}) {
    // Without a limit the server's own holds; JSON has no form for an infinite one.
    const limit = timeout === undefined || timeout === Infinity ? {} : { "x-timeout": timeout };
    return this.#ask({ op: "Call", type: name, jsonMessage: message, ...limit });
  }

  /** The functions that one may see. */
  async functions() {
    return (await this.#ask({ op: "List" })).functions;
  }

  /** What each bridge sees now, and plugins without a bridge; needs `see` for all. */
  async discover() {
    return (await this.#ask({ op: "Discover" })).bridges;
  }

  /** What agents ask for that one may approve; needs `approve`. */
  async approvals() {
    return (await this.#ask({ op: "Approve" })).approvals;
  }

  /** Approve or refuse what another principal asks for: `approve`, `digest`, `cause`. */
  async approve(approval, options = {}) {
    return this.#ask({ op: "Approve", type: approval, jsonMessage: { approve: true, ...options } });
  }

  /** The recordings that there are, and for whom may record all the files. */
  async recordings() {
    return this.#ask({ op: "Record" });
  }

  /** Record functions: `duration`, `max_size`, `split`, `compression`, `ring`; needs `record`. */
  async record(functions, options = {}) {
    return this.#ask({ op: "Record", jsonMessage: { functions, ...options } });
  }

  /** End a recording; that of another needs `kill`, too. */
  async stopRecording(recording) {
    return this.#ask({ op: "Record", type: recording, jsonMessage: { stop: true } });
  }

  /** Write what a recording with a `ring` keeps in memory. */
  async dumpRecording(recording) {
    return this.#ask({ op: "Record", type: recording, jsonMessage: { dump: true } });
  }

  /** Where the recordings are that bridges play. */
  async players() {
    return (await this.#ask({ op: "Play" })).players;
  }

  /** Move what a bridge plays: `pause`, `rate`, `seek`, `step`; without any, say where it is. */
  async playback(bridge, move) {
    return this.#ask({ op: "Play", type: bridge, ...(move && { jsonMessage: move }) });
  }

  /** The plan of a function: data, and text for people. */
  async resolve(name) {
    return this.#ask({ op: "Resolve", type: name });
  }

  /** Change the configuration to this YAML: `dry_run`, `force`, `keep`, `reload_code`, `revision`. */
  async configure(text, options = {}) {
    return this.#ask({ op: "Configure", jsonMessage: { text, ...options } });
  }

  /** Have the configuration of an earlier revision again; options as `configure`. */
  async rollback(revision, options = {}) {
    return this.#ask({ op: "Configure", jsonMessage: { rollback: revision, ...options } });
  }

  /** Stop everything that moves, until `release`: `stopped`, `inputs`, `text`; needs `stop`. */
  async stopAll() {
    // It waits for nothing that was sent before.
    const other = this.#link.holdsUp ? await this.#another().start().catch(() => null) : null;
    if (!other) return this.#ask({ op: "Stop" });
    try {
      return await other.stopAll();
    } finally {
      other.close();
    }
  }

  /** Let commands through again; needs the right `release`. */
  async release() {
    await this.#ask({ op: "Stop", jsonMessage: { release: true } });
  }

  /** The status map, and in `own` what this client received and lost. */
  async status() {
    const known = this.#status;
    this.#status = mergeStatus(known, await this.#ask({ op: "Status", ...sinceStatus(known) }));
    return structuredClone(this.#status);
  }

  /** Changes of the robot, for `for await`, from now on until the connection ends for good. */
  async watch() {
    const mailbox = new Mailbox();
    this.#watchers.add(mailbox);
    await this.#ask({ op: "Status", type: "watch" });
    const over = async () => {
      this.#watchers.delete(mailbox);
      return { value: undefined, done: true };
    };
    return { [Symbol.asyncIterator]: () => ({ next: () => mailbox.next(), return: over }) };
  }

  /** End the connection; what waits fails. */
  close() {
    this.#finish(new UoarmError("closed", "the client was closed"));
    this.#link.close();
  }

  /** What keeps messages from coming, as far as the server says so at once. */
  async #diagnose(connection) {
    let timer;
    const late = new Promise((resolve) => {
      timer = setTimeout(resolve, DIAGNOSIS_SECONDS * 1000, {});
    });
    const status = await Promise.race([this.status().catch(() => ({})), late]);
    clearTimeout(timer);
    return findTrouble(status, connection);
  }

  #ask(fields, stream = null) {
    if (this.#ended) return Promise.reject(this.#ended);
    const id = String(this.#next++);
    return new Promise((resolve, reject) => {
      this.#link.send({ ...fields, id });
      const given = fields["x-timeout"] ?? (fields.op === "Request" ? fields.jsonMessage?.wait : 0) ?? 0;
      const seconds = this.#answer + (Number(given) || 0); // of what is no number the server says so
      const timer = later(() => this.#giveUp(id, seconds), seconds);
      this.#asked.set(id, { fields, stream, timer, resolve, reject });
    });
  }

  #giveUp(id, seconds) {
    const { fields: { op, type }, reject } = this.#forget(id);
    if (op === "Request") this.#abandoned.add(id);
    if (op === "Call") this.#ask({ op: "Kill", type: id, jsonMessage: { call: true } }).catch(() => {});
    const what = type === undefined ? op : `${op} ${type}`;
    const text = [`${this.#place} has not answered ${what} within ${seconds} s`, this.#link.trouble];
    reject(new UoarmError("timeout", text.filter(Boolean).join("; ")));
  }

  #forget(id) {
    const asked = this.#asked.get(id);
    this.#asked.delete(id);
    clearTimeout(asked?.timer);
    return asked;
  }

  #take(received, octets) {
    const { op, type, id, jsonMessage: message } = received;
    if (op === "Data") {
      // 0: what lies between is not lost
      const number = received["x-standing"] ? 0 : checked(received["x-number"], "number", "Data");
      this.#streams.get(type)?.take(number, message, octets);
    }
    else if (op === "Status") this.#takeStatus(type, message);
    else this.#takeAnswer(op, type, id, message);
  }

  #takeStatus(type, message) {
    if (Object.hasOwn(NOTICES, type)) checked(message, NOTICES[type], `Status ${type}`);
    if (type === "hello") {
      this.hello = message;
      this.#link.most = message.message_bytes ?? Infinity;
    }
    else if (type === "change") for (const watcher of this.#watchers) watcher.put(message);
    else if (type === "connection") {
      this.#streams.get(message.connection)?.finish(message.state, message.cause, message.number);
      this.#streams.delete(message.connection);
    }
  }

  #takeAnswer(op, type, id, message) {
    if (op === "Error" && id === undefined) this.#streams.get(type)?.refuse(errorOf(message).message);
    if (this.#abandoned.delete(id) && op === "Reply") {
      this.#ask({ op: "Kill", type: checked(message, ANSWERS.Request, "Reply").connection }).catch(() => {});
    }
    if (!this.#asked.has(id)) return;
    if (op !== "Reply" && op !== "Error") throw new Error("op: expected Reply or Error");
    const { fields } = this.#asked.get(id);
    let error = op === "Error" ? errorOf(message) : null;
    try {
      if (!error) checkedAnswer(fields, message);
    } catch (wrong) {
      if (fields.op === "Request") throw wrong; // what it opened cannot be given back
      error = new UoarmError("unreadable", wrong.message);
    }
    const asked = this.#forget(id);
    if (error) asked.reject(error);
    else if (asked.fields.op === "Request") {
      // Made here, since the first message may follow before the caller has woken.
      const stream = asked.stream ?? new Stream(
        asked.fields, (fields) => this.#ask(fields), (connection) => this.#diagnose(connection),
      );
      stream.open(message);
      this.#away.delete(stream);
      this.#streams.set(stream.connection, stream);
      asked.resolve(stream);
    } else {
      if (asked.fields.op === "Kill") this.#streams.delete(type);
      asked.resolve(message);
    }
  }

  #fail(error) {
    for (const id of [...this.#asked.keys()]) this.#forget(id).reject(error);
    this.#abandoned.clear();
  }

  /** Fails what waits, and lets nothing be sent to connections of a session that is gone. */
  #lose(error) {
    this.#fail(error);
    for (const stream of this.#streams.values()) {
      stream.suspend();
      this.#away.add(stream);
    }
    this.#streams.clear();
  }

  /** Count what a drop took, of what the server says of this client's connections. */
  #settle(own) {
    for (const { connection, number } of own) if (number !== null) this.#streams.get(connection)?.settle(number);
  }

  /** Has a new session report what changes, and open what the one before had. */
  #openAgain() {
    if (this.#watchers.size) this.#ask({ op: "Status", type: "watch" }).catch(() => {});
    for (const stream of this.#away) {
      if (stream.state === "open") this.#renew(stream);
      else this.#away.delete(stream);
    }
  }

  async #renew(stream) {
    const { restarts } = this;
    try {
      await this.#ask(stream.request, stream);
      if (stream.state !== "open") await this.#ask({ op: "Kill", type: stream.connection });
    } catch (error) {
      if (restarts !== this.restarts) return; // it is tried again already
      this.#away.delete(stream);
      stream.finish("failed", `after a restart of the server: ${error.message}`);
    }
  }

  #finish(error) {
    this.#ended ??= error;
    this.#fail(this.#ended);
    for (const stream of [...this.#streams.values(), ...this.#away]) stream.finish("failed", this.#ended.message);
    for (const watcher of this.#watchers) watcher.finish(null);
    this.#streams.clear();
    this.#away.clear();
  }
}

/**
 * Connect to a server. With `binary` octets come as Uint8Array instead of base64 text; with
 * `resume` a connection that drops is renewed, and the session goes on. Where that is gone, as after
 * a restart of the server, a new one is tried for `reconnect` seconds and what was open is opened
 * again; `gaps` of a stream counts it. What waited for an answer fails; no command is repeated. An
 * answer comes within `answer` seconds, beyond those that the question gives it, or not at all.
 */
export async function connect(
  url, { token, binary = false, timeout = 10, resume = true, reconnect = 60, answer = 120, WebSocket } = {},
) {
  const Socket = WebSocket ?? globalThis.WebSocket;
  if (!Socket) throw new UoarmError("usage", NO_SOCKET);
  for (const [name, value] of Object.entries({ timeout, reconnect, answer })) checkSeconds(name, value);
  const form = binary ? FORMS.cbor : FORMS.json;
  const protocols = [form.protocol];
  const shown = token?.trim(); // as it is read from a file
  if (shown && !TOKEN.test(shown)) throw new UoarmError("usage", NO_TOKEN);
  if (shown !== undefined) protocols.push(`uoarm.token.${shown}`);
  const open = () => {
    try {
      return opened(Socket, url, protocols);
    } catch { // with a text that may have the token
      throw new UoarmError("usage", NO_URL);
    }
  };
  const shownUrl = String(url).replace(/([?&]token=)[^&#]*/, "$1***");
  const place = `the server at ${shownUrl}`;
  try {
    return await new Robot({ place, open, form, timeout, resume, reconnect, answer }).start();
  } catch (error) {
    if (!(error instanceof UoarmError)) throw error;
    throw new UoarmError(error.code === "usage" ? "usage" : "closed", `${shownUrl}: ${error.message}`);
  }
}
