// The native protocol over one WebSocket: questions with answers, and notices of the server.

const FORM = "uoarm.v1.json";
const FIRST_WAIT = 500;
const LONGEST_WAIT = 8000;
const OPENING = 10_000; // until the server says hello: a browser waits for minutes
const MOST_SILENCE = 20; // looks without a message, after which the connection is given up

/** An answer that says no. `code` is for programs, `message` for people. */
export class Refusal extends Error {
  constructor({ code, text, rejected }) {
    super(text);
    this.code = code;
    this.rejected = rejected ?? null;
  }
}

/**
 * Keeps a WebSocket to the server open, and opens it again after it broke.
 *
 * receive: called with (op, type, message) for Data and Status, and with
 * ("link", "open" | "closed" | "locked") when the connection itself changes.
 */
export class Wire {
  constructor(url, receive, { socket = WebSocket, isLocked = async () => false } = {}) {
    this.url = url;
    this.receive = receive;
    this.socket = socket;
    this.isLocked = isLocked;
    this.token = "";
    this.wait = FIRST_WAIT;
    this.count = 0;
    this.asked = new Map();
    this.silence = 0; // looks since something came
  }

  open() {
    const forms = this.token ? [FORM, `uoarm.token.${this.token}`] : [FORM];
    const link = new this.socket(this.url, forms);
    this.link = link;
    this.silence = 0;
    link.onmessage = (event) => this.#read(JSON.parse(event.data));
    link.onclose = () => link === this.link && this.#closed();
    clearTimeout(this.opening);
    this.opening = setTimeout(() => this.#giveUp(), OPENING);
    this.opening.unref?.(); // in Node.js: it keeps no test running
  }

  /** Resolves to the reply's message; rejects with a Refusal. */
  ask(op, type = "", message = undefined) {
    const id = String(++this.count);
    return new Promise((resolve, reject) => {
      if (this.link?.readyState !== 1) {
        reject(new Refusal({ code: "closed", text: "not connected to the server" }));
        return;
      }
      this.asked.set(id, { resolve, reject });
      const request = type ? { op, type, id } : { op, id };
      if (message !== undefined) request.jsonMessage = message;
      this.link.send(JSON.stringify(request));
    });
  }

  /** Once a second, while something is asked as often: a network may go without a word. */
  look() {
    this.silence += 1;
    if (this.silence <= MOST_SILENCE) return;
    this.#giveUp();
  }

  #giveUp() {
    this.link.onclose = this.link.onmessage = null;
    this.link.close();
    this.#closed();
  }

  #read({ op, type, id, jsonMessage }) {
    this.silence = 0;
    const asker = this.asked.get(id);
    this.asked.delete(id);
    if (op === "Reply") asker?.resolve(jsonMessage);
    else if (op === "Error" && asker) asker.reject(new Refusal(jsonMessage));
    else {
      if (op === "Status" && type === "hello") {
        clearTimeout(this.opening);
        this.wait = FIRST_WAIT;
        this.receive("link", "open", jsonMessage);
      }
      this.receive(op, type, jsonMessage);
    }
  }

  async #closed() {
    clearTimeout(this.opening);
    for (const { reject } of this.asked.values()) {
      reject(new Refusal({ code: "closed", text: "the connection to the server broke" }));
    }
    this.asked.clear();
    this.receive("link", "closed");
    if (await this.isLocked(this.token)) {
      this.receive("link", "locked");
      return;
    }
    setTimeout(() => this.open(), this.wait);
    this.wait = Math.min(this.wait * 2, LONGEST_WAIT);
  }
}
