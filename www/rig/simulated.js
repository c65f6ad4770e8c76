// The simulated board (arm/simulated in the core) in the shape of a SerialPort.

import { SimulatedBoard } from "../pkg/core/coil_ps.js";

export class SimulatedPort {
  /** @type {ReadableStream<Uint8Array> | null} */
  readable = null;
  /** @type {WritableStream<Uint8Array> | null} */
  writable = null;
  /** @type {ReadableStreamDefaultController<Uint8Array> | null} */
  #controller = null;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  #timer;

  /** @type {number} */
  #pace;

  /** @param {"guide" | "stock"} [kind] @param {number} [pace] how many times as fast as a real board it is */
  constructor(kind = "guide", pace = 1) {
    this.board = new SimulatedBoard(kind);
    this.#pace = pace;
  }

  /** The board's time. */
  #now() {
    return performance.now() * this.#pace;
  }

  getInfo() {
    return {};
  }

  async open() {
    if (this.readable) throw new DOMException("The port is already open.", "InvalidStateError");
    this.board.open(this.#now());
    this.readable = new ReadableStream({
      start: controller => { this.#controller = controller; },
      cancel: () => { this.#controller = null; },
    });
    this.writable = new WritableStream({
      write: bytes => {
        this.board.write(this.#now(), bytes);
        this.#pump();
      },
    });
    this.#pump();
  }

  #pump = () => {
    clearTimeout(this.#timer);
    if (!this.readable) return;
    const bytes = this.board.read(this.#now());
    if (bytes.length) this.#controller?.enqueue(bytes);
    const wait = Math.min(((this.board.next() ?? Infinity) - this.#now()) / this.#pace, 20);
    this.#timer = setTimeout(this.#pump, Math.max(wait, 1));
  };

  async close() {
    clearTimeout(this.#timer);
    if (this.readable) this.board.close(this.#now());
    this.readable = this.writable = null;
  }

  /** The cable is pulled: what a real port does then. */
  unplug() {
    clearTimeout(this.#timer);
    const controller = this.#controller;
    this.readable = this.writable = this.#controller = null;
    this.board.close(this.#now());
    controller?.error(new DOMException("The device has been lost.", "NetworkError"));
  }
}
