// One object of state and who wants to know when a part of it changes.

/**
 * @template {object} S
 */
export class Store {
  /** @type {{ keys: (keyof S)[], listener: (state: Readonly<S>) => void }[]} */
  #listeners = [];
  /** What has changed since the listeners were called. @type {Set<keyof S>} */
  #changed = new Set();

  /** @param {S} state */
  constructor(state) {
    /** @type {Readonly<S>} */
    this.state = state;
  }

  /**
   * Replaces parts of the state. The listeners hear of it once in the next frame, however many changes there were.
   * @param {Partial<S>} patch
   */
  update(patch) {
    const before = this.state;
    this.state = { ...before, ...patch };
    const changed = /** @type {(keyof S)[]} */ (Object.keys(patch)).filter(key => before[key] !== this.state[key]);
    if (!this.#changed.size && changed.length) requestAnimationFrame(() => this.#tell());
    for (const key of changed) this.#changed.add(key);
  }

  #tell() {
    const changed = this.#changed;
    this.#changed = new Set();
    for (const { keys, listener } of this.#listeners) {
      if (keys.some(key => changed.has(key))) listener(this.state);
    }
  }

  /**
   * Calls `listener` now, and in the next frame after one of `keys` has changed.
   * @param {(keyof S)[]} keys
   * @param {(state: Readonly<S>) => void} listener
   */
  watch(keys, listener) {
    this.#listeners.push({ keys, listener });
    listener(this.state);
  }
}

/**
 * Makes of an asynchronous function one that runs once at a time and skips all calls but the newest.
 * @template {unknown[]} A
 * @param {(...args: A) => Promise<void>} work
 * @returns {(...args: A) => void}
 */
export function newestOnly(work) {
  let busy = false;
  /** @type {A | null} */
  let next = null;
  return (...args) => {
    next = args;
    if (busy) return;
    busy = true;
    (async () => {
      while (next) {
        const now = next;
        next = null;
        await work(...now);
      }
    })().finally(() => { busy = false; });
  };
}
