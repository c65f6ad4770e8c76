// One serial port: opens, reads, writes, closes, says what went wrong. It knows bytes, not what they mean.
//
// A port is anything shaped like a SerialPort of Web Serial: the simulated board (simulated.js) is one too.

/**
 * @typedef {object} PortLike
 * @property {(options: { baudRate: number, bufferSize?: number }) => Promise<void>} open
 * @property {() => Promise<void>} close
 * @property {ReadableStream<Uint8Array> | null} readable
 * @property {WritableStream<Uint8Array> | null} writable
 * @property {() => { usbVendorId?: number, usbProductId?: number }} [getInfo]
 *
 * @typedef {{ bytes: (bytes: Uint8Array) => void, lost: (reason: string) => void }} PortEvents
 */

/** Why there is no port to choose from; null where there is Web Serial. */
export function unsupported() {
  if (!window.isSecureContext) return "Serial ports need a secure page: open it over https, or from localhost.";
  if (!("serial" in navigator)) return "This browser has no Web Serial. Chrome or Edge from 89, Opera from 76 and Firefox from 151 have it; Safari has not. The simulated arm works everywhere.";
  return null;
}

/** The serial ports of this thread: of the page, or of a worker where the browser has them there. @returns {any} */
export function serial() {
  return /** @type {any} */ (navigator).serial;
}

/**
 * What the system said, in words that help.
 * @param {unknown} error
 */
export function explain(error) {
  const { name, message } = /** @type {Error} */ (error);
  if (name === "NetworkError" || name === "InvalidStateError" && /already open/i.test(message)) {
    return "The port is busy: another program has it open (Arduino IDE, a serial monitor, another tab). Close that and connect again.";
  }
  if (name === "SecurityError") return "The browser does not allow serial ports on this page (its settings, or a policy).";
  return message || name;
}

/** @param {PortLike} port */
export function portName(port) {
  const info = port.getInfo?.() ?? {};
  if (!info.usbVendorId) return "Serial port";
  const known = /** @type {Record<number, string>} */ ({ 0x2341: "Arduino", 0x2a03: "Arduino", 0x1a86: "CH340 board", 0x0403: "FTDI board", 0x10c4: "CP210x board" });
  const id = (/** @type {number | undefined} */ n) => (n ?? 0).toString(16).padStart(4, "0");
  return `${known[info.usbVendorId] ?? "USB serial"} (${id(info.usbVendorId)}:${id(info.usbProductId)})`;
}

export class Port {
  /** @type {ReadableStreamDefaultReader<Uint8Array> | null} */
  #reader = null;
  /** @type {WritableStreamDefaultWriter<Uint8Array> | null} */
  #writer = null;
  #closing = false;
  #done = Promise.resolve();

  /**
   * @param {PortLike} raw
   * @param {PortEvents} events
   */
  constructor(raw, events) {
    this.raw = raw;
    this.events = events;
  }

  /** Opens the port; bytes come from then on. */
  async open() {
    await this.raw.open({ baudRate: 115_200, bufferSize: 4096 });
    if (!this.raw.writable) throw new Error("the port cannot be written to");
    this.#writer = this.raw.writable.getWriter();
    this.#writer.closed.catch(() => {});
    this.#done = this.#read();
  }

  async #read() {
    let reason = "the port was closed";
    try {
      // A framing error ends the stream but not the port: go on with its new one.
      while (this.raw.readable && !this.#closing) {
        this.#reader = this.raw.readable.getReader();
        try {
          for (;;) {
            const { value, done } = await this.#reader.read();
            if (done) break;
            if (value) this.events.bytes(value);
          }
          if (!this.#closing && !this.raw.readable) break;
          if (!this.#closing) break;
        } catch (error) {
          const { name, message } = /** @type {Error} */ (error);
          reason = message || name;
          if (!["BufferOverrunError", "FramingError", "BreakError", "ParityError"].includes(name)) throw error;
        } finally {
          this.#reader.releaseLock();
          this.#reader = null;
        }
      }
    } catch { /* said below */ }
    if (!this.#closing) this.events.lost(reason);
  }

  /**
   * Hands bytes to the port at once. A failure is told as a loss.
   * @param {Uint8Array} bytes
   */
  write(bytes) {
    this.#writer?.write(bytes).catch(error => {
      if (!this.#closing) this.events.lost(/** @type {Error} */ (error).message || "the port does not take bytes any more");
    });
  }

  /** Releases the locks and closes the port, whatever state it is in. */
  async close() {
    this.#closing = true;
    await this.#reader?.cancel().catch(() => {});
    await this.#done.catch(() => {});
    try { this.#writer?.releaseLock(); } catch { /* the stream is gone with the port */ }
    this.#writer = null;
    await this.raw.close().catch(() => {});
  }
}
