// Workers that share long work: images to decode, pieces of an object to solve, normals to integrate.

import { BROKEN } from "./errors.js";

/** @typedef {import("./messages.js").HelperReply} HelperReply */
/** @typedef {import("./messages.js").HelperRequest} HelperRequest */
/** @typedef {Extract<HelperReply, { kind: "done" }>} Done */
/** @typedef {import("./pkg/core/coil_ps.js").Tiles} Tiles */
/** @typedef {import("./pkg/core/coil_ps.js").Solution} Solution */

/** More of them gain nothing: one worker puts together what they make. */
const MOST = 8;
/** Pixels of a piece: some 25 ms of the learned solver, after which a helper hears of something more urgent. */
const PIECE = 512;
/** Messages that a helper is given ahead, so that it never waits. */
const AHEAD = { image: 4, piece: 2, normals: 1 };

/**
 * Work that can be shared.
 * @typedef {object} Job
 * @property {keyof typeof AHEAD} kind
 * @property {() => { message: HelperRequest & { id: number }, transfer: Transferable[] } | null} next null when all is given out
 * @property {(reply: Done) => void} done takes a result in
 * @property {(error: Error) => void} fail
 *
 * @typedef {{ worker: Worker, given: Map<number, Job> }} Helper
 */

export class Helpers {
  #module;
  /** @type {Helper[]} */
  #helpers = [];
  /** Those in front come first. @type {Job[]} */
  #jobs = [];
  #lastId = 0;
  /** The network of the learned solver, once it is needed. @type {Promise<Uint8Array> | null} */
  #network = null;

  /** @param {Promise<WebAssembly.Module>} module compiled once for all of them */
  constructor(module) {
    this.#module = module;
  }

  /** Starts the workers, if they are not there: that takes as long as decoding several images. */
  async start() {
    const module = await this.#module;
    const count = Math.min(Math.max(navigator.hardwareConcurrency || 2, 1), MOST);
    while (this.#helpers.length < count) {
      const worker = new Worker(new URL("helper.js", import.meta.url), { type: "module", name: "coil-ps helper" });
      /** @type {Helper} */
      const helper = { worker, given: new Map() };
      worker.onerror = event => this.#lost(helper, new Error(`a helper has failed: ${event.message}`));
      worker.onmessage = ({ data }) => this.#receive(helper, data);
      worker.postMessage({ kind: "module", module });
      this.#helpers.push(helper);
    }
  }

  /**
   * Decodes images; `done(k, bits, pixels)` is called for each, in any order.
   * @param {{ name: string, bytes: () => File | ArrayBuffer }[]} images
   * @param {{ mask: Uint8Array, width: number, height: number }} object
   * @param {AbortSignal} signal
   * @param {(k: number, bits: number, pixels: Uint16Array) => void} done
   */
  async decode(images, object, signal, done) {
    await this.start();
    signal.throwIfAborted();
    for (const { worker } of this.#helpers) worker.postMessage({ kind: "object", ...object });
    let next = 0;
    const places = new Map();
    await this.#share("image", images.length, signal, () => {
      if (next >= images.length) return null;
      const id = ++this.#lastId;
      const { name, bytes } = images[next];
      places.set(id, next);
      next += 1;
      return { message: { kind: "image", id, bytes: bytes(), name }, transfer: [] };
    }, ({ id, bits, result }) => done(places.get(id), bits, new Uint16Array(result)));
  }

  /**
   * Solves an object with the learned solver. `onLevel(levels)` is called when a coarser picture of it is complete.
   * @param {Tiles} tiles
   * @param {{ signal: AbortSignal, urgent: boolean, onPiece?: (part: number) => void, onLevel?: () => void }} options
   * urgent: before all other work; part: of the pixels, 0…1
   */
  async solve(tiles, { signal, urgent, onPiece, onLevel }) {
    await Promise.all([this.start(), this.network()]);
    signal.throwIfAborted();
    const lights = tiles.lights();
    const { total } = tiles;
    const firsts = new Map();
    let level = 0;
    await this.#share("piece", total, signal, () => {
      const piece = tiles.next(PIECE);
      if (!piece) return null;
      const id = ++this.#lastId;
      const { first, count, values, saturated } = piece;
      piece.free();
      firsts.set(id, first);
      return { message: { kind: "piece", id, solver: "pixel", lights, values, saturated, count }, transfer: [values.buffer, saturated.buffer] };
    }, ({ id, result }) => {
      tiles.put(firsts.get(id), new Float32Array(result));
      const { done, levels } = tiles;
      onPiece?.(done / total);
      if (levels > level && done < total) onLevel?.();
      level = levels;
      return done;
    }, urgent);
  }

  /**
   * Heights of an object's pixels from their normals: seconds, in one helper.
   * @param {{ mask: Uint8Array, width: number, height: number, normals: Float32Array }} object
   * @param {AbortSignal} signal
   */
  async integrate(object, signal) {
    await this.start();
    signal.throwIfAborted();
    const id = ++this.#lastId;
    let given = false;
    let heights = new Float32Array();
    try {
      await this.#share("normals", 1, signal, () => {
        if (given) return null;
        given = true;
        return { message: { kind: "normals", id, ...object }, transfer: [] };
      }, ({ result }) => { heights = new Float32Array(result); }, true);
    } finally {
      // One that was aborted is still at it: a new helper is there sooner.
      const busy = this.#helpers.find(helper => helper.given.has(id));
      if (busy) this.#end(busy);
    }
    return heights;
  }

  /** Fetches the learned solver's network and gives it to all helpers; its bytes. */
  network() {
    this.#network ??= (async () => {
      const reply = await fetch(new URL("models/pixel.onnx", import.meta.url))
        .catch(error => { throw new Error(`the network of the learned solver could not be fetched (${error.message})`); });
      if (!reply.ok) throw new Error(`the network of the learned solver is not there: models/pixel.onnx, status ${reply.status}`);
      const bytes = new Uint8Array(await reply.arrayBuffer());
      await this.start();
      for (const { worker } of this.#helpers) worker.postMessage({ kind: "network", id: 0, bytes });
      return bytes;
    })();
    this.#network.catch(() => { this.#network = null; }); // the next call tries again
    return this.#network;
  }

  /**
   * Gives work out until `count` of it is taken in.
   * @param {Job["kind"]} kind
   * @param {number} count
   * @param {AbortSignal} signal
   * @param {Job["next"]} next
   * @param {(reply: Done) => number | void} take what is taken in after this reply; without it, each reply counts 1
   * @param {boolean} [urgent]
   */
  async #share(kind, count, signal, next, take, urgent = false) {
    if (!count) return;
    /** @type {PromiseWithResolvers<void>} */
    const { promise, resolve, reject } = Promise.withResolvers();
    let taken = 0;
    /** @type {Job} */
    const job = {
      kind,
      next,
      done: reply => {
        taken = take(reply) ?? taken + 1;
        if (taken >= count) resolve();
      },
      fail: reject,
    };
    const abort = () => reject(signal.reason);
    signal.addEventListener("abort", abort);
    if (urgent) this.#jobs.unshift(job);
    else this.#jobs.push(job);
    for (const helper of this.#helpers) this.#feed(helper);
    try {
      await promise;
    } finally {
      signal.removeEventListener("abort", abort);
      this.#jobs = this.#jobs.filter(other => other !== job);
    }
  }

  /** A job whose work can't be made ready (a file that is gone or damaged) fails alone. @param {Job} job */
  #next(job) {
    try {
      return job.next();
    } catch (error) {
      job.fail(/** @type {Error} */ (error));
      this.#jobs = this.#jobs.filter(other => other !== job);
      return null;
    }
  }

  /** @param {Helper} helper */
  #feed({ worker, given }) {
    for (const job of this.#jobs) {
      if ([...given.values()].some(({ kind }) => kind === "normals")) return; // for seconds
      while (given.size < AHEAD[job.kind]) {
        const work = this.#next(job);
        if (!work) break;
        given.set(work.message.id, job);
        worker.postMessage(work.message, work.transfer);
      }
    }
  }

  /**
   * @param {Helper} helper
   * @param {HelperReply} reply
   */
  #receive(helper, reply) {
    if (reply.kind === "failed" && reply.error.name === BROKEN) return this.#lost(helper, new Error(reply.error.message));
    const job = helper.given.get(reply.id);
    helper.given.delete(reply.id);
    this.#feed(helper);
    if (!job || !this.#jobs.includes(job)) return; // it was aborted, or has failed before
    try {
      if (reply.kind === "failed") throw new Error(reply.error.message);
      job.done(reply);
    } catch (error) {
      job.fail(/** @type {Error} */ (error));
    }
  }

  /** @param {Helper} helper @param {Error} error */
  #lost(helper, error) {
    this.#end(helper);
    for (const job of helper.given.values()) job.fail(error);
  }

  /** Ends a helper; `start` makes another. @param {Helper} helper */
  #end(helper) {
    helper.worker.terminate();
    this.#helpers = this.#helpers.filter(other => other !== helper);
    this.#network = null; // the new one must be given it
  }
}
