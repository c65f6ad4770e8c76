// The trained planners: a second build of the core that can run networks, and their files. Fetched when first used.

/** @typedef {typeof import("./pkg/core/coil_ps.js")} Lib */
/** @typedef {import("./pkg/core/coil_ps.js").CapturedObject} CapturedObject */
/** @typedef {import("./pkg/core/coil_ps.js").Evaluation} Evaluation */
/** @typedef {import("./pkg/core/coil_ps.js").Rig} Rig */
/** @typedef {import("./pkg/core/coil_ps.js").Observations} Observations */

/**
 * What only the second build has.
 * @typedef {object} PolicyModels
 * @property {(name: string, encoder: Uint8Array, step: Uint8Array) => void} add
 * @property {(name: string, encoder: Uint8Array, step: Uint8Array) => void} addLimited
 * @property {(name: string, observations: Observations, lights: number) => Insight | undefined} insight
 *
 * @typedef {object} Insight
 * @property {(observations: Observations, i: number) => Float32Array} observe
 * @property {(observations: Observations) => import("./pkg/core/coil_ps.js").Picture | undefined} gatePicture
 * @property {() => void} free
 *
 * @typedef {{ Models: new () => PolicyModels }} Learning
 */

/** Planners with a network, and the folders of their files. @type {Record<string, string>} */
export const LEARNED = {
  coil: "compact",
  "coil-no-gate": "compact-no-gate",
  "coil-no-transformer": "compact-no-transformer",
  "coil-blank": "compact-blank",
};

/** Folder of the network with which a planner plans where lights have a limited reach. @param {string} folder */
const limited = folder => `${folder}-limited`;

const MODULE = new URL("pkg/policy/coil_ps.js", import.meta.url);

/** The trained planners that are loaded. */
export class Models {
  #models;
  #loaded = new Set();

  /** @param {PolicyModels} models */
  constructor(models) {
    this.#models = models;
  }

  /**
   * Fetches a planner's network, and that for a limited reach where there is one, if that was not done.
   * @param {string} name
   * @param {AbortSignal} signal
   * @param {(what: string) => void} progress
   */
  async load(name, signal, progress) {
    if (this.#loaded.has(name)) return;
    progress(`fetching the network of ${name}`);
    /** @param {Error} error */
    const failed = error => {
      signal.throwIfAborted();
      throw new Error(`the network of ${name} could not be fetched (${error.message})`);
    };
    /** @param {string} folder */
    const files = folder => Promise.all(["encoder", "step"].map(async part => {
      const reply = await fetch(new URL(`models/${folder}/${part}.onnx`, import.meta.url), { signal }).catch(failed);
      if (!reply.ok) throw new Error(`the trained network of ${name} is not there: ${part}.onnx, status ${reply.status}`);
      return new Uint8Array(await reply.arrayBuffer());
    }));
    const folder = LEARNED[name];
    const [[encoder, step], narrow] = await Promise.all([
      files(folder),
      networks(signal).then(models => models.includes(limited(folder)) ? files(limited(folder)) : null),
    ]);
    progress(`loading the network of ${name}`);
    this.#models.add(name, encoder, step);
    if (narrow) this.#models.addLimited(name, narrow[0], narrow[1]);
    this.#loaded.add(name);
  }

  /**
   * A network at work; undefined where it is not loaded.
   * @param {string} name
   * @param {Observations} observations
   * @param {number} lights how many pictures the run has
   */
  insight(name, observations, lights) {
    return this.#models.insight(name, observations, lights);
  }

  /** Lets an evaluation or a rig use them. @param {Evaluation | Rig} user */
  lend(user) {
    /** @type {{ useModels(models: PolicyModels): void }} */ (/** @type {unknown} */ (user)).useModels(this.#models);
  }
}

/**
 * Fetches and starts the second build.
 * @param {AbortSignal} signal
 * @param {(what: string) => void} progress
 */
export async function loadFull(signal, progress) {
  progress("fetching the runtime for learned planners");
  await built(signal, progress);
  const lib = /** @type {Lib & Learning} */ (await import(String(MODULE)).catch(() => {
    throw new Error("the runtime of the learned planners could not be fetched");
  }));
  await lib.default({ module_or_path: new URL("pkg/policy/coil_ps_bg.wasm", import.meta.url) });
  signal.throwIfAborted();
  return { lib, models: new Models(new lib.Models()), adopt: (/** @type {CapturedObject} */ object) => adopt(lib, object) };
}

/** What became of the second build; null where nothing is known of one. @param {AbortSignal} [signal] */
async function status(signal) {
  const reply = await fetch(new URL("build-status.json", import.meta.url), { signal, cache: "no-store" });
  return reply.ok ? (await reply.json()).modules?.policy ?? null : null;
}

/** Folders of the trained networks that came with this page. @param {AbortSignal} [signal] @returns {Promise<string[]>} */
async function networks(signal) {
  const reply = await fetch(new URL("models/index.json", import.meta.url), { signal });
  if (!reply.ok) throw new Error(`the list of trained networks is not there (status ${reply.status})`);
  return (await reply.json()).models;
}

/**
 * The learned planners that can be offered: their module is there or on its way, and so is their network. Where ours is not,
 * `withheld` is a sentence that says why.
 * @returns {Promise<{ names: string[], withheld: string }>}
 */
export async function learnedPlanners() {
  try {
    const policy = await status();
    if (policy === null) throw new Error("this page was built without the module for learned planners");
    if (policy.state === "failed") throw new Error(notBuilt(policy));
    const models = await networks();
    if (!models.includes(LEARNED.coil)) throw new Error("its trained network is not there");
    return { names: Object.keys(LEARNED).filter(name => models.includes(LEARNED[name])), withheld: "" };
  } catch (error) {
    return { names: [], withheld: `COIL-PS, the learned planner, is not offered: ${error instanceof Error ? error.message : error}.` };
  }
}

/** @param {{ message?: string }} policy */
const notBuilt = policy => `the module for learned planners was not built: ${policy.message}`;

/**
 * Waits while the server that came with this page still compiles the module.
 * @param {AbortSignal} signal
 * @param {(what: string) => void} progress
 */
async function built(signal, progress) {
  for (;;) {
    const policy = await status(signal);
    if (policy?.state === "failed") throw new Error(notBuilt(policy));
    if (policy?.state !== "building" && policy?.state !== "waiting") return;
    progress(policy.state === "building" ? `the server compiles the learned planners (${policy.seconds} s)` : "the learned planners are compiled next");
    await new Promise(resolve => setTimeout(resolve, 1000));
    signal.throwIfAborted();
  }
}

/**
 * The same object in another build, which has a memory of its own.
 * @param {Lib} lib
 * @param {CapturedObject} object
 */
function adopt(lib, object) {
  const { name, width, height, bits, images } = object;
  const header = lib.ObjectHeader.of(name, width, height, object.mask(), object.names(), object.lights(), object.intensities(), object.trueNormals());
  for (let k = 0; k < images; k += 1) header.put(k, bits, object.image(k));
  return header.assemble();
}
