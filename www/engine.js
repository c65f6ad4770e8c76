// The page's side of the worker: one call a request, with progress and an abort signal.

import { BROKEN } from "./errors.js";

/** @typedef {import("./messages.js").Calls} Calls */
/** @typedef {import("./messages.js").Kind} Kind */
/** @typedef {import("./messages.js").Reply} Reply */

/** A worker that has not answered an abort after so long is ended, unless the call says otherwise. */
const PATIENCE_MS = 80;

/** Requests that make the worker what it is; a new one repeats the last of each. */
const LASTING = /** @type {Kind[]} */ (["open", "prepare"]);

/**
 * @template {Kind} K
 * @typedef {{ signal?: AbortSignal, patience?: number, onProgress?: (progress: Calls[K]["progress"]) => void }} CallOptions
 * patience: milliseconds
 */

/**
 * @typedef {object} Pending
 * @property {{ id: number, kind: Kind }} request as posted
 * @property {AbortSignal} [signal]
 * @property {(value: any) => void} resolve
 * @property {(error: Error) => void} reject
 * @property {(progress: any) => void} [onProgress]
 */

export class Engine {
  /** @type {Map<number, Pending>} */
  #pending = new Map();
  /** @type {Map<Kind, any>} */
  #lasting = new Map();
  #lastId = 0;
  #worker = this.#start();
  /** Settles when the worker has what it had before it was ended. */
  #restored = Promise.resolve();

  /** Called when the worker fails outside of any request: a defect, or no WebAssembly here. */
  onCrash = /** @type {(error: Error) => void} */ (error => console.error(error));

  /** Called when a new worker has the object of the one before, but nothing of what was shown. */
  onRestored = () => {};

  /** Called when a new worker could not be given the object, and has none. */
  onLost = /** @type {(error: Error) => void} */ (() => {});

  /** Whether the worker has, or is being given, an object. */
  get opened() {
    return this.#lasting.has("open");
  }

  /**
   * @template {Kind} K
   * @param {K} kind
   * @param {Calls[K]["body"]} body
   * @param {CallOptions<K>} [options]
   * @returns {Promise<Calls[K]["reply"]>}
   */
  async call(kind, body, options = {}) {
    await this.#restored;
    options.signal?.throwIfAborted();
    const reply = await this.#send(kind, body, options);
    if (LASTING.includes(kind)) this.#lasting.set(kind, body);
    if (kind === "open") this.#lasting.delete("prepare");
    return reply;
  }

  /**
   * @param {Kind} kind
   * @param {object} body
   * @param {{ signal?: AbortSignal, patience?: number, onProgress?: (progress: any) => void }} options
   * @returns {Promise<any>}
   */
  #send(kind, body, { signal, patience = PATIENCE_MS, onProgress }) {
    const id = ++this.#lastId;
    return new Promise((resolve, reject) => {
      const abort = () => {
        this.#worker.postMessage({ id, kind: "abort" });
        setTimeout(() => this.#pending.has(id) && this.#restart(), patience);
      };
      const settled = () => signal?.removeEventListener("abort", abort);
      const request = { id, kind, ...body };
      this.#pending.set(id, {
        request,
        signal,
        resolve: value => { settled(); resolve(value); },
        reject: error => { settled(); reject(error); },
        onProgress,
      });
      signal?.addEventListener("abort", abort);
      this.#worker.postMessage(request);
    });
  }

  #start() {
    const worker = new Worker(new URL("worker.js", import.meta.url), { type: "module", name: "coil-ps" });
    worker.onmessage = ({ data }) => this.#receive(data);
    worker.onerror = event => {
      event.preventDefault();
      const error = new Error(event.message || "the worker could not be started");
      for (const { reject } of this.#pending.values()) reject(error);
      this.#pending.clear();
      this.onCrash(error);
      if (this.opened) this.#restart();
    };
    return worker;
  }

  /** @param {Reply} reply */
  #receive(reply) {
    const pending = this.#pending.get(reply.id);
    if (!pending) return;
    if (reply.type === "progress") return pending.onProgress?.(reply.value);
    this.#pending.delete(reply.id);
    if (reply.type === "done") return pending.resolve(reply.value);
    const { name, message } = reply.error;
    pending.reject(name === "AbortError" ? aborted() : Object.assign(new Error(message), { name }));
    if (name !== BROKEN) return;
    // What breaks it is not repeated; an object that it breaks on can't be worked with.
    if (LASTING.includes(pending.request.kind)) this.#lasting.clear();
    this.#restart();
  }

  /** Ends a worker that is deep in a computation, or broken, and gives a new one the same object and what else was asked. */
  #restart() {
    this.#worker.terminate();
    const waiting = [...this.#pending.values()];
    for (const [id, { signal, reject }] of this.#pending) {
      if (!signal?.aborted) continue;
      this.#pending.delete(id);
      reject(aborted());
    }
    this.#worker = this.#start();
    this.#restored = (async () => {
      for (const kind of LASTING) {
        if (this.#lasting.has(kind)) await this.#send(kind, this.#lasting.get(kind), {});
      }
      for (const { request, signal } of waiting) if (!signal?.aborted) this.#worker.postMessage(request);
      if (this.opened) this.onRestored();
    })().catch(error => {
      this.#lasting.clear();
      for (const { request, reject } of waiting) if (this.#pending.delete(request.id)) reject(error);
      this.onLost(error);
    });
  }
}

/** @returns {Error} */
function aborted() {
  return new DOMException("cancelled", "AbortError");
}

/**
 * Whether `error` only says that the user, or a newer request, has ended something.
 * @param {unknown} error
 */
export function isAbort(error) {
  return error instanceof DOMException && error.name === "AbortError";
}
