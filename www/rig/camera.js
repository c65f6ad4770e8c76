// The cameras of the page: a webcam, and files that the user chooses. Pictures go to the rig's worker as they are.

import { html } from "../svg.js";

/** How a webcam may be told to hold still: setting, its word for that, name for people. */
const LOCKS = /** @type {const} */ ([
  ["exposureMode", "manual", "exposure"],
  ["whiteBalanceMode", "manual", "white balance"],
  ["focusMode", "manual", "focus"],
]);
/** Pictures that a webcam still has under way when its exposure time is changed. */
const STALE_PICTURES = 4;

/** @param {unknown} error */
export function explainCamera(error) {
  const { name, message } = /** @type {Error} */ (error);
  if (name === "NotAllowedError") return "The browser may not use the camera: allow it for this page (the camera sign in the address bar), and in the system's privacy settings.";
  if (name === "NotFoundError" || name === "OverconstrainedError") return "No such camera is connected.";
  if (name === "NotReadableError") return "The camera is busy: another program or tab uses it.";
  return message || name;
}

export class Webcam {
  /** @type {MediaStream | null} */
  #stream = null;

  constructor() {
    this.video = html("video", { muted: true, playsinline: true, class: "rig-live", "aria-label": "Live picture of the camera" });
    this.video.muted = true;
  }

  /** Why there is none; null where the browser can. */
  static unsupported() {
    return navigator.mediaDevices ? null : "Cameras need a secure page: open it over https, or from localhost.";
  }

  /** Names are known after the first permission. @returns {Promise<MediaDeviceInfo[]>} */
  static async devices() {
    const all = await navigator.mediaDevices?.enumerateDevices() ?? [];
    return all.filter(device => device.kind === "videoinput");
  }

  get track() {
    return this.#stream?.getVideoTracks()[0] ?? null;
  }

  /** @param {string} deviceId empty: any */
  async open(deviceId) {
    this.close();
    const video = { width: { ideal: 4096 }, height: { ideal: 4096 }, ...(deviceId ? { deviceId: { exact: deviceId } } : {}) };
    this.#stream = await navigator.mediaDevices.getUserMedia({ video, audio: false });
    this.video.srcObject = this.#stream;
    await this.video.play();
  }

  close() {
    for (const track of this.#stream?.getTracks() ?? []) track.stop();
    this.#stream = null;
    this.video.srcObject = null;
  }

  /** Exposure times that can be set, milliseconds; null where they can't. */
  exposureRange() {
    const { exposureTime } = /** @type {any} */ (this.track?.getCapabilities?.() ?? {});
    // The unit of the standard is 100 µs.
    return exposureTime ? { least: exposureTime.min / 10, most: exposureTime.max / 10 } : null;
  }

  /** Holds what the camera would else change by itself. @returns {Promise<{ held: string[], free: string[] }>} */
  async lock() {
    const can = /** @type {any} */ (this.track?.getCapabilities?.() ?? {});
    const [held, free] = [/** @type {string[]} */ ([]), /** @type {string[]} */ ([])];
    for (const [setting, value, name] of LOCKS) {
      const offered = can[setting]?.includes(value);
      const done = offered && await this.track?.applyConstraints({ advanced: [{ [setting]: value }] }).then(() => true, () => false);
      (done ? held : free).push(name);
    }
    return { held, free };
  }

  /**
   * The next pictures, of that exposure time where it can be set.
   * @param {number} milliseconds
   * @param {number} count
   * @returns {Promise<import("./messages.js").Shot>}
   */
  async take(milliseconds, count) {
    const { track } = this;
    if (!track || track.readyState !== "live") throw new Error("the camera is not open, or was unplugged: open it again");
    let stale = 1;
    if (this.exposureRange()) {
      const constraints = /** @type {any} */ ({ advanced: [{ exposureMode: "manual", exposureTime: 10 * milliseconds }] });
      await track.applyConstraints(constraints);
      stale = STALE_PICTURES;
    }
    const bitmaps = [];
    for (let k = 0; k < stale + count; k += 1) {
      await this.#picture();
      if (k >= stale) bitmaps.push(await createImageBitmap(this.video));
    }
    return { bitmaps, milliseconds };
  }

  /** The next picture is there. */
  #picture() {
    return new Promise((resolve, reject) => {
      const late = setTimeout(() => reject(new Error("the camera sends no pictures")), 10_000);
      this.video.requestVideoFrameCallback(() => {
        clearTimeout(late);
        resolve(null);
      });
    });
  }
}

/**
 * Asks for image files, in the order of the exposures. Null when none were chosen. Needs a click to begin with.
 * @returns {Promise<File[] | null>}
 */
export function chooseImages() {
  return new Promise(resolve => {
    const input = html("input", { type: "file", multiple: true, accept: ".png,.tif,.tiff,image/png,image/tiff" });
    input.addEventListener("change", () => {
      const files = [...input.files ?? []].sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));
      resolve(files.length ? files : null);
    });
    input.addEventListener("cancel", () => resolve(null));
    input.click();
  });
}

/**
 * A folder of the user's; null where the browser has no such dialog, or none was chosen.
 * @param {"read" | "readwrite"} mode
 * @param {string} id
 */
export async function chooseFolder(mode, id) {
  const choose = /** @type {any} */ (window).showDirectoryPicker;
  if (!choose) return null;
  try {
    return /** @type {FileSystemDirectoryHandle} */ (await choose({ id, mode }));
  } catch (error) {
    if (/** @type {Error} */ (error).name === "AbortError") return null;
    throw error;
  }
}
