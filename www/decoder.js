// Decodes images for the worker: bytes in, the values of the object's pixels out.

import { decodePixels, initSync } from "./pkg/core/coil_ps.js";

/** @typedef {import("./messages.js").DecoderReply} DecoderReply */

/** @type {{ mask: Uint8Array, width: number, height: number } | null} */
let object = null;

/** @param {MessageEvent<import("./messages.js").DecoderRequest>} event */
self.onmessage = async ({ data }) => {
  if (data.kind === "module") return void initSync({ module: data.module });
  if (data.kind === "object") return void (object = data);
  const { id, bytes, name } = data;
  try {
    if (!object) throw new Error("no mask came before the first image");
    const buffer = bytes instanceof ArrayBuffer ? bytes : await bytes.arrayBuffer();
    const decoded = decodePixels(new Uint8Array(buffer), object.mask, object.width, object.height, name);
    const { bits, rgb } = decoded;
    decoded.free();
    reply({ kind: "image", id, bits, pixels: /** @type {ArrayBuffer} */ (rgb.buffer) }, [rgb.buffer]);
  } catch (error) {
    reply({ kind: "failed", id, message: error instanceof Error ? error.message : String(error) });
  }
};

/**
 * @param {DecoderReply} message
 * @param {Transferable[]} [transfer]
 */
function reply(message, transfer = []) {
  self.postMessage(message, { transfer });
}
