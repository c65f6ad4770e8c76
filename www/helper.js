// Works for the worker: decodes images (bytes in, the values of the object's pixels out) solves pieces of an object and
// integrates its normals.

import { told } from "./errors.js";
import { decodePixels, initSync, integrateNormals, loadPixelNetwork, solvePiece } from "./pkg/core/coil_ps.js";

/** @typedef {import("./messages.js").HelperReply} HelperReply */

/** @type {{ mask: Uint8Array, width: number, height: number } | null} */
let object = null;

/** @param {MessageEvent<import("./messages.js").HelperRequest>} event */
self.onmessage = async ({ data }) => {
  if (data.kind === "module") return void initSync({ module: data.module });
  if (data.kind === "object") return void (object = data);
  const { id } = data;
  try {
    if (data.kind === "network") {
      loadPixelNetwork(data.bytes);
      reply({ kind: "done", id, bits: 0, result: new ArrayBuffer(0) });
    } else if (data.kind === "piece") {
      const { buffer } = solvePiece(data.solver, data.lights, data.values, data.saturated, data.count);
      reply({ kind: "done", id, bits: 0, result: /** @type {ArrayBuffer} */ (buffer) });
    } else if (data.kind === "normals") {
      const { buffer } = integrateNormals(data.mask, data.width, data.height, data.normals);
      reply({ kind: "done", id, bits: 0, result: /** @type {ArrayBuffer} */ (buffer) });
    } else {
      if (!object) throw new Error("no mask came before the first image");
      const buffer = data.bytes instanceof ArrayBuffer ? data.bytes : await data.bytes.arrayBuffer();
      const decoded = decodePixels(new Uint8Array(buffer), object.mask, object.width, object.height, data.name);
      const { bits, rgb } = decoded;
      decoded.free();
      reply({ kind: "done", id, bits, result: /** @type {ArrayBuffer} */ (rgb.buffer) });
    }
  } catch (error) {
    reply({ kind: "failed", id, error: told(error) });
  }
};

/** @param {HelperReply} message */
function reply(message) {
  self.postMessage(message, { transfer: message.kind === "done" ? [message.result] : [] });
}
