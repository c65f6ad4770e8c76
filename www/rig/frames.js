// The rig's worker's exposures: from the simulated camera, from a folder that is watched, or from the view.

import { now, sleep } from "./clock.js";

/** @typedef {import("./messages.js").Camera} Camera */
/** @typedef {import("./messages.js").Shot} Shot */

/** Read-out of the simulated camera. */
const READ_OUT_MS = 30;
/** How long a watched folder may stay without a new image. */
const PATIENCE_MS = 60_000;

/**
 * @param {import("./line.js").Owner["lib"]} lib
 * @param {Shot} shot
 * @param {Camera} from
 */
export function frameOf(lib, shot, from) {
  if ("bytes" in shot) {
    const { black, white } = "black" in from ? from : { black: 0, white: null };
    return lib.Frame.decode(new Uint8Array(shot.bytes), shot.milliseconds, black, white ?? undefined);
  }
  const { width, height } = shot.bitmaps[0];
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  if (!context) throw new Error("no canvas to read the camera's pictures with");
  const mean = new lib.FrameAverage(width, height);
  for (const bitmap of shot.bitmaps) {
    context.drawImage(bitmap, 0, 0);
    bitmap.close();
    mean.add(new Uint8Array(context.getImageData(0, 0, width, height).data.buffer));
  }
  const made = mean.frame(shot.milliseconds);
  mean.free();
  return made;
}

/** @param {FileSystemDirectoryHandle} watched @returns {Promise<Map<string, FileSystemFileHandle>>} */
async function images(watched) {
  const found = new Map();
  for await (const [name, handle] of /** @type {any} */ (watched).entries()) {
    if (handle.kind === "file" && /\.(png|tiff?)$/i.test(name)) found.set(name, handle);
  }
  return found;
}

export class Frames {
  #owner;
  #line;
  /** Files of the watched folder that belong to no exposure still to come. @type {Set<string>} */
  #known = new Set();
  /** @type {((shot: { shot: Shot | null, reason: string }) => void) | null} */
  #came = null;
  /** @type {Camera} */
  camera = { kind: "sim" };
  /** Whether the arm's board triggers the camera. */
  shutter = false;

  /**
   * @param {import("./line.js").Owner} owner
   * @param {import("./line.js").Line} line
   */
  constructor(owner, line) {
    this.#owner = owner;
    this.#line = line;
  }

  /** What the view was asked for; null: there is none, for that reason. @param {{ shot: Shot | null, reason: string }} came */
  came(came) {
    this.#came?.(came);
  }

  /** The images that are in the folder now belong to no exposure still to come. @param {FileSystemDirectoryHandle} watched */
  async pass(watched) {
    this.#known = new Set((await images(watched)).keys());
  }

  /** Takes the exposure that the rig waits for. @param {Record<string, any>} doing */
  async expose(doing) {
    const milliseconds = doing.until;
    if (this.#owner.rig.simulated) {
      const s = this.#owner.rig.shown();
      const [azimuth, slant, led] = this.#line.truth() ?? [s.azimuth ?? 0, s.slant ?? 0, s.led ?? 0];
      await sleep(milliseconds + READ_OUT_MS);
      // What happened meanwhile decides whether the exposure is still wanted.
      if (this.#wanted()) this.#owner.rig.exposeSimulated(azimuth, slant, led, milliseconds);
      return;
    }
    /** @type {Shot | null} */
    let shot;
    if (this.camera.kind === "folder") {
      if (doing.index === 0 && !this.shutter) await this.pass(this.camera.folder);
      shot = await this.#nextImage(this.camera.folder, milliseconds);
    } else {
      this.#owner.tell({ type: "expose", number: doing.number, index: doing.index, milliseconds, count: doing.exposures });
      /** @type {{ shot: Shot | null, reason: string }} */
      const came = await new Promise(resolve => { this.#came = resolve; });
      this.#came = null;
      if (!came.shot && !this.#owner.idle) throw new Error(came.reason);
      shot = came.shot;
    }
    if (shot && this.#wanted()) this.#owner.rig.expose(frameOf(this.#owner.lib, shot, this.camera));
  }

  #wanted() {
    return this.#owner.rig.step(now()).action === "expose";
  }

  /** The next new image of the watched folder, once it has stopped growing. @param {FileSystemDirectoryHandle} watched @param {number} milliseconds */
  async #nextImage(watched, milliseconds) {
    let last = "";
    for (const end = now() + PATIENCE_MS; now() < end && !this.#owner.idle; await sleep(80)) {
      const fresh = [...await images(watched)].filter(([name]) => !this.#known.has(name));
      const files = await Promise.all(fresh.map(([, handle]) => handle.getFile()));
      // As they were saved; of one moment, img9 before img10.
      const [file] = files.sort((a, b) => a.lastModified - b.lastModified || a.name.localeCompare(b.name, "en", { numeric: true }));
      if (!file) continue;
      const size = `${file.name} ${file.size}`;
      if (file.size && size === last) {
        this.#known.add(file.name);
        return { bytes: await file.arrayBuffer(), milliseconds };
      }
      last = size;
    }
    if (this.#owner.idle) return null;
    throw new Error(`no new image in the folder in ${PATIENCE_MS / 1000} s: does the camera save there, and is it triggered?`);
  }
}
