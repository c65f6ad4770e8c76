// The rig view's side of its worker.

/** @typedef {import("./messages.js").Calls} Calls */
/** @typedef {import("./messages.js").Kind} Kind */
/** @typedef {import("./messages.js").Told} Told */

export class Client {
  #worker = new Worker(new URL("worker.js", import.meta.url), { type: "module", name: "coil-ps-rig" });
  /** @type {Map<number, { resolve: (value: any) => void, reject: (error: Error) => void }>} */
  #pending = new Map();
  #lastId = 0;

  /**
   * @param {(told: Told) => void} told
   * @param {(error: Error) => void} crashed
   */
  constructor(told, crashed) {
    this.#worker.onmessage = ({ data }) => {
      if (data.id === undefined) return told(data);
      const pending = this.#pending.get(data.id);
      this.#pending.delete(data.id);
      if (data.type === "done") pending?.resolve(data.value);
      else pending?.reject(Object.assign(new Error(data.error.message), { name: data.error.name }));
    };
    this.#worker.onerror = event => {
      event.preventDefault();
      const error = new Error(event.message || "the rig's worker could not be started");
      for (const { reject } of this.#pending.values()) reject(error);
      this.#pending.clear();
      crashed(error);
    };
  }

  /**
   * @template {Kind} K
   * @param {K} kind
   * @param {Calls[K]["body"]} body
   * @param {Transferable[]} [transfer]
   * @returns {Promise<Calls[K]["reply"]>}
   */
  call(kind, body, transfer = []) {
    const id = ++this.#lastId;
    return new Promise((resolve, reject) => {
      this.#pending.set(id, { resolve, reject });
      this.#worker.postMessage({ id, kind, ...body }, transfer);
    });
  }
}
