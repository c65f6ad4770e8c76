// The rig's worker's line to the arm: a port that is opened, fed and listened to, and opened again when it was lost.

import { now, sleep } from "./clock.js";
import { Port } from "./port.js";
import { SimulatedPort } from "./simulated.js";

/** @typedef {import("./port.js").PortEvents} PortEvents */
/** @typedef {{ open: () => Promise<void>, write: (bytes: Uint8Array) => void, close: () => Promise<void> }} AnyPort */

/**
 * The worker as its line and its frames see it.
 * @typedef {object} Owner
 * @property {import("../pkg/core/coil_ps.js").Rig} rig the one in use: another planner may need another
 * @property {typeof import("../pkg/core/coil_ps.js")} lib the build in use
 * @property {boolean} idle whether no capture is under way
 * @property {() => Record<string, any>} show tells the arm's state, and returns it
 * @property {(told: import("./messages.js").Told) => void} tell
 * @property {() => void} advance goes on with the capture
 */

/** A USB port takes so long to come back. */
const RECONNECT_MS = 8000;

/** The port of another thread. @param {MessagePort} rigPort @param {PortEvents} events @returns {AnyPort} */
function remote(rigPort, events) {
  /** @type {{ resolve: () => void, reject: (error: Error) => void } | null} */
  let opening = null;
  rigPort.onmessage = ({ data }) => {
    const message = /** @type {import("./host.js").FromHost} */ (data);
    if (message.type === "bytes") events.bytes(message.bytes);
    else if (message.type === "lost") events.lost(message.reason);
    else if (message.type === "opened") opening?.resolve();
    else if (message.type === "failed") opening?.reject(Object.assign(new Error(message.message), { name: message.name }));
  };
  const post = (/** @type {import("./host.js").ToHost} */ message) => rigPort.postMessage(message);
  return {
    open: () => new Promise((resolve, reject) => {
      opening = { resolve, reject };
      post({ type: "open" });
    }),
    write: bytes => post({ type: "write", bytes }),
    close: async () => post({ type: "close" }),
  };
}

export class Line {
  #owner;
  /** Makes the port anew for each opening. @type {((events: PortEvents) => AnyPort) | null} */
  #make = null;
  /** @type {AnyPort | null} */
  #port = null;
  /** @type {SimulatedPort | null} */
  #simulated = null;
  /** @type {MessagePort | null} */
  #channel = null;
  #wanted = false;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  #timer;
  /** How many times as fast as a real one the simulated arm is. */
  pace = 1;

  /** @param {Owner} owner */
  constructor(owner) {
    this.#owner = owner;
  }

  /** Whether the user wants to be connected. */
  get wanted() {
    return this.#wanted;
  }

  get opened() {
    return this.#port !== null;
  }

  /** Azimuth, slant and LED as they are, which only a simulated board tells. */
  truth() {
    return this.#simulated?.board.truth() ?? null;
  }

  /** @param {MessagePort | null} port null: the simulated arm */
  async connect(port) {
    this.#simulated = null;
    this.#channel = port;
    if (port) this.#make = events => remote(port, events);
    else {
      const board = this.#simulated = new SimulatedPort("guide", this.pace);
      this.#make = events => new Port(board, events);
    }
    this.#wanted = true;
    this.#owner.show();
    try {
      await this.#open();
    } catch (error) {
      this.#giveUp();
      throw error;
    }
  }

  async disconnect() {
    this.#wanted = false;
    const gone = this.#port;
    this.#port = null;
    clearTimeout(this.#timer);
    this.#owner.rig.closed(undefined);
    this.#owner.show();
    await gone?.close();
  }

  /** @param {boolean} sent whether the bytes of Stop went out already */
  stop(sent) {
    if (!this.#port) return;
    this.#owner.rig.stop(now());
    const bytes = this.#owner.rig.takeOutput();
    // Another thread's port has sent them past us, and is silent until now.
    if (sent && this.#channel) this.#channel.postMessage({ type: "resume" });
    else this.#port.write(bytes);
    this.pump();
  }

  /** @param {Uint8Array} bytes */
  write(bytes) {
    if (bytes.length) this.#port?.write(bytes);
  }

  /** Sends what the rig has to say now, and comes back when it will have more. */
  pump() {
    clearTimeout(this.#timer);
    if (!this.#port) return void this.#owner.show();
    this.write(this.#owner.rig.tick(now()));
    const shown = this.#owner.show();
    if (shown.phase === "closed") return void this.#lost(shown.reason ?? "the firmware does not answer");
    this.#timer = setTimeout(() => this.pump(), Math.max((this.#owner.rig.wake(now()) ?? now() + 200) - now(), 1));
    this.#owner.advance();
  }

  async #open() {
    if (!this.#make) throw new Error("no port was chosen");
    /** @type {AnyPort} */
    const mine = this.#make({
      bytes: bytes => { if (this.#port === mine) { this.#owner.rig.receive(now(), bytes); this.pump(); } },
      lost: reason => { if (this.#port === mine) this.#lost(reason); },
    });
    await mine.open();
    this.#port = mine;
    this.#owner.rig.opened(now());
    // Before anything is asked of the capture: stuck for the port that was lost, it would end what it can now go on with.
    this.#owner.rig.retry();
    this.pump();
  }

  /** @param {string} reason */
  async #lost(reason) {
    const gone = this.#port;
    if (!gone) return;
    this.#port = null;
    this.#owner.rig.closed(reason);
    this.#owner.show();
    await gone.close();
    if (!this.#wanted) return;
    const said = this.#owner.rig.shown().reason ?? "";
    // A board that does not speak Grbl will not speak it on the next try either.
    if (/not as Grbl|did not confirm/.test(said)) {
      this.#giveUp();
      return this.#owner.tell({ type: "help", text: "The port opened, but nothing there speaks Grbl 1.1 at 115200 baud." });
    }
    const end = now() + RECONNECT_MS;
    while (this.#wanted && now() < end) {
      await sleep(400);
      try {
        return await this.#open();
      } catch { /* not there yet */ }
    }
    this.#giveUp();
    this.#owner.tell({ type: "problem", message: `The port did not come back in ${RECONNECT_MS / 1000} s (${reason}). The session is stored: connect and continue.` });
  }

  #giveUp() {
    this.#wanted = false;
    this.#owner.show();
  }
}
