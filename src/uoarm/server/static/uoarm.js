// A client of `uoarm serve` for browsers and Node, without dependencies. Types: uoarm.d.ts.
import { decode, encode } from "./uoarm-cbor.js";
import { Link, UoarmError } from "./uoarm-link.js";

export { UoarmError };

const HELD = 1024;
const FORMS = {
  json: { protocol: "uoarm.v1.json", read: JSON.parse, write: JSON.stringify },
  cbor: { protocol: "uoarm.v1.cbor", read: decode, write: encode },
};

/** Messages for one reader: waits for the next, ends once, and keeps the newest when it is slow. */
class Mailbox {
  #waiting = [];
  #readers = [];
  #end = null;

  put(item) {
    const reader = this.#readers.shift();
    if (reader) reader.resolve({ value: item, done: false });
    else if (this.#waiting.push(item) > HELD) this.#waiting.shift();
  }

  finish(error) {
    this.#end ??= { error };
    for (const reader of this.#readers.splice(0)) this.#tell(reader);
  }

  next() {
    return new Promise((resolve, reject) => {
      const reader = { resolve, reject };
      if (this.#waiting.length) resolve({ value: this.#waiting.shift(), done: false });
      else if (this.#end) this.#tell(reader);
      else this.#readers.push(reader);
    });
  }

  #tell({ resolve, reject }) {
    if (this.#end.error) reject(this.#end.error);
    else resolve({ value: undefined, done: true });
  }
}

/** One open function: `for await`, `send`, `kill`. */
export class Stream {
  #ask;
  #mailbox = new Mailbox();
  #last = 0;
  #ended = false;

  constructor(opened, ask) {
    this.connection = opened.connection;
    this.inputs = opened.inputs;
    this.warnings = opened.warnings;
    this.lost = 0;
    this.#ask = ask;
  }

  [Symbol.asyncIterator]() {
    return { next: () => this.#next(), return: async () => {
      await this.kill();
      return { value: undefined, done: true };
    } };
  }

  /** The next message, or undefined when no more will come. */
  async get() {
    return (await this.#next()).value;
  }

  /** Hand one message to an input; resolves when the server has taken it. */
  async send(message, input) {
    const type = input === undefined ? this.connection : `${this.connection}.${input}`;
    await this.#ask({ op: "Data", type, jsonMessage: message });
  }

  /** Give the function back. Once is enough. */
  async kill() {
    if (this.#ended) return;
    this.finish("closed", "");
    await this.#ask({ op: "Kill", type: this.connection });
  }

  take(number, message) {
    this.#mailbox.put({ number, message });
  }

  finish(state, cause) {
    this.#ended = true;
    this.#mailbox.finish(state === "failed" ? new UoarmError("closed", cause) : null);
  }

  async #next() {
    const { value, done } = await this.#mailbox.next();
    if (done) return { value: undefined, done };
    if (this.#last) this.lost += value.number - this.#last - 1;
    this.#last = value.number;
    return { value: value.message, done: false };
  }
}

/** A robot behind a server; made by `connect`. */
export class Robot {
  #link;
  #asked = new Map();
  #streams = new Map();
  #watchers = new Set();
  #next = 1;
  #ended = null;

  constructor(open, form, timeout) {
    this.hello = null;
    const take = (told) => this.#take(told);
    this.#link = new Link({ open, form, timeout, take, ended: (error) => this.#finish(error) });
  }

  /** How often the connection dropped and the session went on over another. */
  get resumed() {
    return this.#link.resumed;
  }

  /** Connect; `connect` does it. */
  async start(resume) {
    await this.#link.start(resume);
    return this;
  }

  /** Open a function, or `function.output`. */
  async request(name, options = {}) {
    return this.#ask({ op: "Request", type: name, jsonMessage: options });
  }

  /** Call a service; `timeout` in seconds. */
  async call(name, message, { timeout } = {}) {
    const limit = timeout === undefined ? {} : { "x-timeout": timeout };
    return this.#ask({ op: "Call", type: name, jsonMessage: message, ...limit });
  }

  /** The functions that one may see. */
  async functions() {
    return (await this.#ask({ op: "List" })).functions;
  }

  /** The plan of a function: data, and text for people. */
  async resolve(name) {
    return this.#ask({ op: "Resolve", type: name });
  }

  /** Change the configuration to this YAML: `dry_run`, `force`, `revision`; needs `configure`. */
  async configure(text, options = {}) {
    return this.#ask({ op: "Configure", jsonMessage: { text, ...options } });
  }

  /** Have the configuration of an earlier revision again; options as `configure`. */
  async rollback(revision, options = {}) {
    return this.#ask({ op: "Configure", jsonMessage: { rollback: revision, ...options } });
  }

  /** Stop everything that moves, until `release`: `stopped`, `inputs`, `text`; needs `stop`. */
  async stopAll() {
    return this.#ask({ op: "Stop" });
  }

  /** Let commands through again; needs the right `release`. */
  async release() {
    await this.#ask({ op: "Stop", jsonMessage: { release: true } });
  }

  /** The status map, and in `own` what this client received and lost. */
  async status() {
    return this.#ask({ op: "Status" });
  }

  /** Changes of the robot, for `for await`, from now on. */
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

  #ask(fields) {
    if (this.#ended) return Promise.reject(this.#ended);
    const id = String(this.#next++);
    return new Promise((resolve, reject) => {
      this.#link.send({ ...fields, id });
      this.#asked.set(id, { op: fields.op, resolve, reject });
    });
  }

  #take(told) {
    const { op, type, id, jsonMessage: message } = told;
    if (op === "Data") this.#streams.get(type)?.take(told["x-number"], message);
    else if (op === "Status") this.#takeStatus(type, message);
    else this.#takeAnswer(op, type, id, message);
  }

  #takeStatus(type, message) {
    if (type === "hello") this.hello = message;
    else if (type === "change") for (const watcher of this.#watchers) watcher.put(message);
    else if (type === "connection") {
      this.#streams.get(message.connection)?.finish(message.state, message.cause);
      this.#streams.delete(message.connection);
    }
  }

  #takeAnswer(op, type, id, message) {
    const asked = this.#asked.get(id);
    this.#asked.delete(id);
    if (!asked) return;
    if (op === "Error") asked.reject(new UoarmError(message.code, message.text));
    else if (asked.op === "Request") {
      // Made here, since the first message may follow before whoever asked has woken.
      const stream = new Stream(message, (fields) => this.#ask(fields));
      this.#streams.set(stream.connection, stream);
      asked.resolve(stream);
    } else {
      if (asked.op === "Kill") this.#streams.delete(type);
      asked.resolve(message);
    }
  }

  #finish(error) {
    this.#ended ??= error;
    for (const { reject } of this.#asked.values()) reject(this.#ended);
    for (const stream of this.#streams.values()) stream.finish("failed", this.#ended.message);
    for (const watcher of this.#watchers) watcher.finish(null);
    this.#asked.clear();
    this.#streams.clear();
  }
}

/**
 * Connect to a server. With `binary` octets come as Uint8Array instead of base64 text; with
 * `resume` a connection that drops is renewed, and the session goes on.
 */
export async function connect(
  url, { token, binary = false, timeout = 10, resume = true, WebSocket } = {},
) {
  const Socket = WebSocket ?? globalThis.WebSocket;
  if (!Socket) throw new UoarmError("usage", "there is no WebSocket here: hand one over");
  const form = binary ? FORMS.cbor : FORMS.json;
  const protocols = [form.protocol];
  if (token !== undefined) protocols.push(`uoarm.token.${token}`);
  try {
    return await new Robot(() => new Socket(url, protocols), form, timeout).start(resume);
  } catch (error) {
    throw error instanceof UoarmError ? new UoarmError("closed", `${url}: ${error.message}`) : error;
  }
}
