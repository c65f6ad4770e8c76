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

  /** @param {"guide" | "stock"} [kind] */
  constructor(kind = "guide") {
    this.board = new SimulatedBoard(kind);
  }

  getInfo() {
    return {};
  }

  async open() {
    if (this.readable) throw new DOMException("The port is already open.", "InvalidStateError");
    this.board.open(performance.now());
    this.readable = new ReadableStream({
      start: controller => { this.#controller = controller; },
      cancel: () => { this.#controller = null; },
    });
    this.writable = new WritableStream({
      write: bytes => {
        this.board.write(performance.now(), bytes);
        this.#pump();
      },
    });
    this.#pump();
  }

  #pump = () => {
    clearTimeout(this.#timer);
    if (!this.readable) return;
    const bytes = this.board.read(performance.now());
    if (bytes.length) this.#controller?.enqueue(bytes);
    const wait = Math.min((this.board.next() ?? Infinity) - performance.now(), 20);
    this.#timer = setTimeout(this.#pump, Math.max(wait, 1));
  };

  async close() {
    clearTimeout(this.#timer);
    if (this.readable) this.board.close(performance.now());
    this.readable = this.writable = null;
  }

  /** The cable is pulled: what a real port does then. */
  unplug() {
    clearTimeout(this.#timer);
    const controller = this.#controller;
    this.readable = this.writable = this.#controller = null;
    this.board.close(performance.now());
    controller?.error(new DOMException("The device has been lost.", "NetworkError"));
  }
}
