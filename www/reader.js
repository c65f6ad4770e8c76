// Reads an object from files: the small ones here, the images in parallel by decoders.

/** @typedef {import("./messages.js").NamedFile} NamedFile */
/** @typedef {import("./messages.js").DecoderReply} DecoderReply */

/** More decoders than this gain nothing: one worker puts the images together. */
const MOST_DECODERS = 8;
/** Images given to a decoder ahead, so that it never waits. */
const AHEAD = 4;

/** Workers that decode images. They stay: starting them takes as long as decoding several images. */
export class Decoders {
  #module;
  /** @type {Worker[]} */
  #workers = [];

  /** @param {Promise<WebAssembly.Module>} module compiled once for all of them */
  constructor(module) {
    this.#module = module;
  }

  /** Starts the workers, if they are not there. */
  async start() {
    const module = await this.#module;
    const count = Math.min(Math.max(navigator.hardwareConcurrency || 2, 1), MOST_DECODERS);
    while (this.#workers.length < count) {
      const worker = new Worker(new URL("decoder.js", import.meta.url), { type: "module", name: "coil-ps decoder" });
      worker.postMessage({ kind: "module", module });
      this.#workers.push(worker);
    }
    return this.#workers;
  }

  /** Ends the workers in the middle of whatever they do. */
  stop() {
    for (const worker of this.#workers.splice(0)) worker.terminate();
  }

  /**
   * Decodes images; `done(k, bits, pixels)` is called for each, in any order.
   * @param {{ name: string, bytes: () => File | ArrayBuffer }[]} images
   * @param {{ mask: Uint8Array, width: number, height: number }} object
   * @param {AbortSignal} signal
   * @param {(k: number, bits: number, pixels: Uint16Array) => void} done
   */
  async decode(images, object, signal, done) {
    const workers = await this.start();
    let next = 0;
    let left = images.length;
    /** @type {PromiseWithResolvers<void>} */
    const { promise, resolve, reject } = Promise.withResolvers();
    const give = (/** @type {Worker} */ worker) => {
      if (next >= images.length) return;
      const k = next++;
      worker.postMessage({ kind: "image", id: k, bytes: images[k].bytes(), name: images[k].name });
    };
    const abort = () => reject(signal.reason);
    signal.addEventListener("abort", abort);
    for (const worker of workers) {
      worker.onerror = event => reject(new Error(`a decoder has failed: ${event.message}`));
      worker.onmessage = (/** @type {MessageEvent<DecoderReply>} */ { data }) => {
        if (data.kind === "failed") return reject(new Error(data.message));
        give(worker);
        try {
          done(data.id, data.bits, new Uint16Array(data.pixels));
        } catch (error) {
          return reject(error);
        }
        left -= 1;
        if (left === 0) resolve();
      };
      worker.postMessage({ kind: "object", ...object });
      for (let i = 0; i < AHEAD; i += 1) give(worker);
    }
    if (left === 0) resolve();
    try {
      await promise;
    } catch (error) {
      this.stop(); // what is still being decoded is of no use
      throw error;
    } finally {
      signal.removeEventListener("abort", abort);
    }
  }
}

/** Files of an object that are read as a whole. */
const SMALL = /(^|\/)(mask\.png|[^/]+\.(txt|mat))$/i;

/**
 * @param {typeof import("./pkg/core/coil_ps.js")} lib the build to read with
 * @param {NamedFile[]} files
 * @param {string | null} wanted name of the object; null for the first
 * @param {Decoders} decoders
 * @param {AbortSignal} signal
 * @param {(progress: { done: number, total: number, what: string }) => void} progress
 */
export async function readObject(lib, files, wanted, decoders, signal, progress) {
  progress({ done: 0, total: 1, what: "looking at the files" });
  const starting = decoders.start();
  const archive = files.length === 1 && /\.zip$/i.test(files[0].path) ? files[0].file : null;
  const byPath = new Map(archive ? [] : files.map(({ path, file }) => [path, file]));
  const listed = archive ? lib.ObjectFiles.zip(await bytesOf(archive), archive.name) : new lib.ObjectFiles();
  for (const path of byPath.keys()) listed.list(path);
  const folders = listed.objects();
  const folder = folders.find(name => shortName(name) === wanted) ?? folders[0] ?? "";
  for (const [path, file] of byPath) {
    const inside = folder === "" || path.startsWith(`${folder}/`);
    if (inside && SMALL.test(path)) listed.add(path, await bytesOf(file));
    signal.throwIfAborted();
  }
  const header = listed.header(folder);
  const { images, width, height, notes } = header;
  const total = images.length;
  await starting;
  let done = 0;
  progress({ done, total, what: "image" });
  const sources = images.map(name => ({ name, bytes: () => byPath.get(name) ?? /** @type {ArrayBuffer} */ (listed.bytes(name).buffer) }));
  await decoders.decode(sources, { mask: header.mask(), width, height }, signal, (k, bits, pixels) => {
    header.put(k, bits, pixels);
    done += 1;
    progress({ done, total, what: "image" });
  });
  listed.free();
  return { object: header.assemble(), notes, objects: folders.map(shortName) };
}

/** @param {File} file */
async function bytesOf(file) {
  return new Uint8Array(await file.arrayBuffer());
}

/** The object's folder without those above it and DiLiGenT's "PNG". @param {string} folder */
function shortName(folder) {
  return (folder.split("/").pop() ?? folder).replace(/PNG$/, "");
}
