/** A client of `uoarm serve` for browsers and Node. The protocol: docs/protocol.md. */

export type Code =
  | "unreadable" | "unknown" | "denied" | "resolution" | "bridge" | "timeout" | "message"
  | "usage" | "closed" | "limit" | "busy" | "configuration" | "held" | "leased"
  | "refused" | "internal";

/** A JSON value, octets, typed arrays and BigInt; these come only with `binary`, else as text. */
export type Message = unknown;

export class UoarmError extends Error {
  readonly code: Code;
}

export interface RequestOptions {
  /** How many messages the server checks against their structure. */
  validate?: "off" | "sampled" | "always";
  /** false: only to send; no messages come. */
  receive?: boolean;
  /** What the server does with messages that this client reads too slowly. */
  queue?: { length?: number; policy?: "latest" | "drop-oldest"; age?: number };
  /** Least seconds between two messages; those between are left out. */
  every?: number;
  /** Seconds to wait for a function that cannot be had yet; 0, the default: that is an error. */
  wait?: number;
}

/** A command that is renewed until `stop`, as while a button is held. */
export class HeldCommand {
  /** What is sent the next time; may be replaced. */
  message: Message;
  /** Resolves when it was stopped; rejects when it cannot be renewed any more. */
  readonly done: Promise<void>;
  /** Have the input stopped. Once is enough; resolves when it has stopped. */
  stop(): Promise<void>;
}

/** One open function. Iterating to the end, or out of the loop, gives it back. */
export class Stream<T = Message> implements AsyncIterable<T> {
  readonly connection: string;
  readonly inputs: readonly string[];
  /** What is received; null where there is nothing to receive, undefined where the server is older. */
  readonly output?: string | null;
  readonly warnings: readonly string[];
  /** Messages that did not get here, as gaps in their numbers. */
  readonly lost: number;
  /** How often the server began anew meanwhile, so that what was lost is not known. */
  readonly gaps: number;
  /** `open`, or how it ended. */
  readonly state: "open" | "closed" | "finished" | "failed";
  /** Why it ended; empty while it is open, and where this client gave it back. */
  readonly cause: string;
  /** What kept messages from coming when `get` last ran out of time; empty from the next one on. */
  readonly trouble: readonly string[];
  [Symbol.asyncIterator](): AsyncIterator<T, undefined>;
  /**
   * The next message, or undefined when no more will come; rejects when the function failed, and
   * with the code `timeout` where none came in `timeout` seconds; see `trouble`; and with the code
   * `usage` where there is no output to read.
   */
  get(options?: { timeout?: number }): Promise<T | undefined>;
  /** Seconds for which a command lives, by input; of those that have a lifetime. */
  readonly lifetimes: Readonly<Record<string, number>>;
  /**
   * Hand one message to an input; resolves when the server has taken it. Where the connection drops
   * it waits for the session to go on, as long as the server keeps that.
   */
  send(message: Message, input?: string, options?: { takeOver?: boolean }): Promise<void>;
  /** Have an input stopped, and give its lease back; what waits of it is discarded. */
  stop(input?: string): Promise<void>;
  /** Renew a command until it is stopped. `period` in seconds; by default a quarter of its life. */
  hold(
    message: Message,
    options?: { input?: string; period?: number; takeOver?: boolean },
  ): HeldCommand;
  /** Give the function back. Once is enough. */
  kill(): Promise<void>;
}

export interface FunctionInfo {
  name: string;
  description: string;
  service: boolean;
  outputs: string[];
  inputs: string[];
  components: { name: string; bridge: string; plugin: string; priority: number }[];
}

export interface Change {
  number: number;
  time: number;
  subject: string;
  change: string;
  cause: string;
  function: string;
}

export class Robot {
  /** What the server said first: protocol, server, session, role, limits. */
  readonly hello: Record<string, unknown>;
  /** How often the connection dropped and the session went on over another. */
  readonly resumed: number;
  /** How often the session was gone and a new one was begun, as `reconnect` says. */
  readonly restarts: number;
  request<T = Message>(name: string, options?: RequestOptions): Promise<Stream<T>>;
  call<T = Message>(name: string, message: Message, options?: { timeout?: number }): Promise<T>;
  functions(): Promise<FunctionInfo[]>;
  resolve(name: string): Promise<{ plan: Record<string, unknown>; text: string }>;
  discover(): Promise<Record<string, unknown>[]>;
  approvals(): Promise<Record<string, unknown>[]>;
  approve(
    approval: string,
    options?: { approve?: boolean; digest?: string; cause?: string },
  ): Promise<Record<string, unknown>>;
  configure(
    text: string,
    options?: {
      dry_run?: boolean;
      force?: boolean;
      keep?: boolean;
      reload_code?: boolean;
      revision?: number;
    },
  ): Promise<Record<string, unknown>>;
  rollback(
    to: number,
    options?: { dry_run?: boolean; force?: boolean; keep?: boolean; revision?: number },
  ): Promise<Record<string, unknown>>;
  stopAll(): Promise<Record<string, unknown>>;
  release(): Promise<void>;
  status(): Promise<Record<string, unknown>>;
  watch(): Promise<AsyncIterable<Change>>;
  close(): void;
}

export interface ConnectOptions {
  token?: string;
  /** CBOR instead of JSON: octets come as Uint8Array, wide integers as BigInt. */
  binary?: boolean;
  /** Seconds until connecting is given up. */
  timeout?: number;
  /** Whether to connect again after a drop and go on with the same session; true by default. */
  resume?: boolean;
  /**
   * Seconds for which a new session is tried where that one is gone, as after a restart of the
   * server, and what was open is opened again; 60 by default. 0: everything that waits fails.
   */
  reconnect?: number;
  /**
   * Seconds after which an answer comes no more, beyond the `timeout` of a call and the `wait` of a
   * request; 120 by default. A question without any rejects with the code `timeout`.
   */
  answer?: number;
  /** A WebSocket class, where there is no global one. */
  WebSocket?: new (url: string, protocols: string[]) => unknown;
}

/** What keeps messages of a connection from coming, of what `status` gave; see `Stream.trouble`. */
export function findTrouble(status: Record<string, unknown>, connection: string): string[];

/** Connect to a server; rejects with a UoarmError when it refuses or is not there. */
export function connect(url: string, options?: ConnectOptions): Promise<Robot>;
