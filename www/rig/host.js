// A serial port for the rig's worker, in another thread: bytes go both ways by messages, and Stop goes past them.
//
// It runs in a worker of its own where the browser has serial ports there (port-worker.js), else in the page.

import { Port } from "./port.js";

/** Hold and reset: what Grbl obeys at once, whatever is queued. */
const STOP = new Uint8Array([0x21, 0x18]);

/**
 * From the rig's worker. `resume` ends the silence after Stop.
 * @typedef {{ type: "open" } | { type: "close" } | { type: "write", bytes: Uint8Array } | { type: "resume" }} ToHost
 *
 * To the rig's worker.
 * @typedef {{ type: "opened" } | { type: "failed", name: string, message: string } | { type: "bytes", bytes: Uint8Array }
 *   | { type: "lost", reason: string } | { type: "closed" }} FromHost
 */

export class Host {
  /** @type {Port | null} */
  #port = null;
  #silent = false;

  /**
   * @param {import("./port.js").PortLike} raw
   * @param {MessagePort} rig
   */
  constructor(raw, rig) {
    this.raw = raw;
    this.rig = rig;
    rig.onmessage = ({ data }) => this.#handle(data);
  }

  /** Stop, past everything: nothing of the worker's goes out until it has heard of it. */
  stop() {
    this.#silent = true;
    this.#port?.write(STOP);
  }

  close() {
    return this.#port?.close();
  }

  /** @param {FromHost} message */
  #tell(message) {
    this.rig.postMessage(message);
  }

  /** @param {ToHost} message */
  async #handle(message) {
    switch (message.type) {
      case "open": {
        const port = new Port(this.raw, {
          bytes: bytes => this.#port === port && this.#tell({ type: "bytes", bytes }),
          lost: reason => {
            if (this.#port !== port) return;
            this.#port = null;
            this.#tell({ type: "lost", reason });
            void port.close();
          },
        });
        try {
          this.#port = port;
          await port.open();
          this.#silent = false;
          this.#tell({ type: "opened" });
        } catch (error) {
          this.#port = null;
          const { name, message } = /** @type {Error} */ (error);
          this.#tell({ type: "failed", name, message });
        }
        return;
      }
      case "close":
        await this.#port?.close();
        this.#port = null;
        return this.#tell({ type: "closed" });
      case "write":
        if (!this.#silent) this.#port?.write(message.bytes);
        return;
      case "resume":
        this.#silent = false;
    }
  }
}
